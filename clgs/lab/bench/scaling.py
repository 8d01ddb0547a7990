"""How time and memory of a training step grow with Gaussians and with pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
import numpy.typing as npt

from clgs.lab.bench.frame_counts import count_frame
from clgs.lab.bench.step import stream_times, trainer_of
from clgs.lab.synthetic.anchor_scene import anchor_scene, square_camera
from clgs.opencl.device import Device
from clgs.scene.camera import Camera
from clgs.scene.scene import Scene

GAUSSIANS = (10_000, 30_000, 100_000, 300_000, 1_000_000, 2_000_000)
GROWTHS = (1, 2, 4, 8)
SIZES = (200, 400, 800, 1414, 2000, 2828)
FIXED_GAUSSIANS, FIXED_SIZE = 100_000, 400
LEAST_REPEATS, SECONDS = 3, 4.0
"""A size is run this often at least, and about this long at most."""


@dataclass(frozen=True)
class Run:
    """One size: what the step worked on, its milliseconds, and the device memory it needed."""

    gaussians: int
    intersections: int
    pixels: int
    milliseconds: float
    peak_bytes: int


@dataclass(frozen=True)
class Growth:
    """Exponent e of time ~ count^e by least squares on logarithms.

    Over all sizes; and over the larger half, in which the fixed costs of a step weigh less. None if
    there were fewer than two sizes.
    """

    exponent: float | None
    exponent_of_larger_half: float | None


@dataclass(frozen=True)
class Memory:
    """Bytes of device memory that one more costs: each the slope of its own sweep.

    A Gaussian and a pixel bring their intersections with them; those are in their bytes. None if
    there were fewer than two sizes.
    """

    per_gaussian: float | None
    per_intersection: float | None
    per_pixel: float | None


@dataclass(frozen=True)
class Scaling:
    """The sweeps and what follows from them; by_intersections: Gaussians grow at fixed numbers."""

    by_gaussians: list[Run]
    by_pixels: list[Run]
    by_intersections: list[Run]
    time_by_gaussians: Growth
    time_by_pixels: Growth
    memory: Memory


def bench_scaling(
    open_device: Callable[[], Device],
    gaussians: Sequence[int],
    sizes: Sequence[int],
    repeats: int,
    report: Callable[[str], None],
) -> Scaling:
    """Run all sweeps; every size has a device of its own, so that its memory is its own.

    By Gaussians: the picture stays, Gaussians of about a pixel become more. By pixels: the scene
    and the view stay, the picture becomes finer. By intersections: Gaussians become larger.
    """
    by_gaussians = []
    for count in gaussians:
        scene, camera = anchor_scene(count, FIXED_SIZE)
        by_gaussians.append(_run(open_device(), scene, camera, repeats))
        report(f"{count:,} Gaussians: {by_gaussians[-1].milliseconds:.1f} ms")
    by_pixels = []
    scene, _ = anchor_scene(FIXED_GAUSSIANS, FIXED_SIZE)
    for size in sizes:
        by_pixels.append(_run(open_device(), scene, square_camera(size), repeats))
        report(f"{size} x {size} pixels: {by_pixels[-1].milliseconds:.1f} ms")
    by_intersections = []
    for factor in GROWTHS:
        larger = scene.anchors.scaling + np.float32(np.log(factor))
        grown = replace(scene, anchors=replace(scene.anchors, scaling=larger))
        by_intersections.append(_run(open_device(), grown, square_camera(FIXED_SIZE), repeats))
        report(f"Gaussians {factor} times as large: {by_intersections[-1].milliseconds:.1f} ms")
    return Scaling(
        by_gaussians,
        by_pixels,
        by_intersections,
        growth([(run.gaussians, run.milliseconds) for run in by_gaussians]),
        growth([(run.pixels, run.milliseconds) for run in by_pixels]),
        Memory(
            _bytes_each([(run.gaussians, run.peak_bytes) for run in by_gaussians]),
            _bytes_each([(run.intersections, run.peak_bytes) for run in by_intersections]),
            _bytes_each([(run.pixels, run.peak_bytes) for run in by_pixels]),
        ),
    )


def _run(device: Device, scene: Scene, camera: Camera, repeats: int) -> Run:
    trainer = trainer_of(device, scene, camera)
    times = stream_times(trainer, LEAST_REPEATS)
    more = min(repeats, round(1e3 * SECONDS / median(times))) - LEAST_REPEATS
    if more > 0:
        times += stream_times(trainer, more)
    peak = device.reserved_bytes
    counts = count_frame(device, trainer.render_next())
    pixels = camera.width * camera.height
    return Run(counts.gaussians, counts.intersections, pixels, median(times), peak)


def growth(points: Sequence[tuple[float, float]]) -> Growth:
    """Exponents of points (count, time)."""
    ordered = np.log(np.array(sorted(points), np.float64).reshape(-1, 2))
    half = ordered[len(ordered) // 2 :] if len(ordered) >= 4 else ordered
    return Growth(_slope(ordered), _slope(half))


def shown(value: float | None, digits: int) -> str:
    """An exponent or bytes for people; a dash if there were fewer than two sizes."""
    return "-" if value is None else f"{value:.{digits}f}"


def _slope(points: npt.NDArray[np.float64]) -> float | None:
    if len(np.unique(points[:, 0])) < 2:
        return None
    return float(np.polyfit(points[:, 0], points[:, 1], 1)[0])


def _bytes_each(points: Sequence[tuple[float, float]]) -> float | None:
    """Slope of points (count, bytes)."""
    return _slope(np.array(points, np.float64).reshape(-1, 2))
