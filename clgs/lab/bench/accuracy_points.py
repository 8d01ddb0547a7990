"""What a render costs, and how far it is from one without truncation."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from clgs.lab.anchor_scene import anchor_scene
from clgs.lab.bench.accuracy_settings import PRESET_SWEEP, Setting, without_stop
from clgs.lab.bench.untruncated import cached_reference
from clgs.lab.selftest.reference_render import relative_l2
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.options import Accuracy, RenderOptions
from clgs.render.frame import DeviceScene, DeviceView, SceneGradients, upload_scene, upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import Scene

Array = npt.NDArray[np.float64]

SYNTHETIC = {
    "small": (100_000, 400, 0.0),
    "dense": (100_000, 200, 0.0),
    "large": (8000, 400, 1.2),
    "tiny": (2000, 64, 0.0),
}
"""Gaussians, pixels of the edge, and what is added to the log scales, by name."""

GOALS = (0.01, 0.1, 1.0)
"""Errors in levels for which the fastest setting is named."""

WARM_UP = 2


@dataclass(frozen=True)
class ViewedScene:
    """A scene and a view of it."""

    name: str
    scene: Scene
    camera: Camera


@dataclass(frozen=True)
class Times:
    """Milliseconds: median, 5th and 95th percentile."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class ImageError:
    """Distance from the reference: levels (1/255), and PSNR in dB."""

    p999: float
    largest: float
    psnr: float


@dataclass(frozen=True)
class GradientError:
    """The errors of each tensor: relative L2, p99 of |error| / max(|g|, rms(g) / 1000)."""

    relative_l2: dict[str, float]
    p99: dict[str, float]


@dataclass(frozen=True)
class Point:
    """What one setting costs and how far off it is; gradients only at full resolution.

    image: against the reference; stopped: against this device's render with the same alpha cut,
    but without a stop and with the full exponential.
    """

    sweep: str
    label: str
    forward: Times
    image: ImageError
    stopped: ImageError | None
    both: Times | None
    gradient: GradientError | None


@dataclass(frozen=True)
class SceneFigures:
    """All settings on one scene, and its sizes."""

    name: str
    anchors: int
    gaussians: int
    intersections: int
    size: tuple[int, int]
    points: list[Point]


def synthetic_subjects(names: list[str], seed: int) -> list[ViewedScene]:
    """The seeded scenes of the given names."""
    subjects = []
    for name in names:
        gaussians, size, growth = SYNTHETIC[name]
        scene, camera = anchor_scene(gaussians, size, seed)
        anchors = replace(scene.anchors, scaling=scene.anchors.scaling + np.float32(growth))
        subjects.append(ViewedScene(name, replace(scene, anchors=anchors), camera))
    return subjects


def bench_accuracy(
    device: Device,
    subject: ViewedScene,
    settings: list[Setting],
    repeats: int,
    report: Callable[[str], None],
) -> SceneFigures:
    """Errors of every setting, then times, the settings taking turns ``repeats`` times."""
    bench = _Bench(device, subject)
    reference = bench.reference(report)
    report(f"{subject.name}: errors of {len(settings)} settings")
    different = list(dict.fromkeys(replace(one.accuracy, name="") for one in settings))
    errors = {accuracy: bench.errors(accuracy, reference) for accuracy in different}
    report(f"{subject.name}: times of {len(different)} different ones, {repeats} rounds")
    times = _take_turns(bench, different, repeats)
    points = []
    for setting in settings:
        accuracy = replace(setting.accuracy, name="")
        forward, both = times[accuracy]
        image, stopped, gradient = errors[accuracy]
        points.append(Point(setting.sweep, setting.label, forward, image, stopped, both, gradient))
    frame = rasterise(device, bench.scene, bench.view)
    counts = len(subject.scene.anchors), len(frame.gaussians), len(frame.tiles.gaussian)
    return SceneFigures(subject.name, *counts, frame.view.size, points)


class _Bench:
    """A subject on the device, with a random gradient of its picture."""

    def __init__(self, device: Device, subject: ViewedScene) -> None:
        self.device, self.subject = device, subject
        self.scene: DeviceScene = upload_scene(device, subject.scene)
        self.settings = subject.scene.settings
        self.view: DeviceView = upload_view(device, subject.camera, self.settings)
        shape = (3, subject.camera.height, subject.camera.width)
        self.d_host = np.random.default_rng(1).normal(size=shape).astype(np.float32)
        self.d_image: DeviceArray = device.upload(self.d_host)
        self.renderers: dict[Accuracy, Renderer] = {}

    def reference(self, report: Callable[[str], None]) -> dict[str, Array]:
        """Image and gradients without truncation."""
        return cached_reference(
            self.subject.scene,
            self.subject.camera.pack(self.settings.near),
            (self.subject.camera.width, self.subject.camera.height),
            np.array(self.settings.background, np.float32),
            self.d_host,
            report,
        )

    def picture(self, accuracy: Accuracy) -> npt.NDArray[np.float32]:
        """Render on the host, like `clgs render`."""
        if accuracy not in self.renderers:
            self.renderers[accuracy] = Renderer.of_device_scene(
                self.device, self.scene, self.settings, RenderOptions(accuracy)
            )
        return self.renderers[accuracy].render(self.subject.camera)

    def gradients(self, accuracy: Accuracy) -> SceneGradients:
        """Compute gradients on the device, like a training step."""
        frame = rasterise(self.device, self.scene, self.view, RenderOptions(accuracy))
        return rasterise_backward(self.device, self.scene, frame, self.d_image)

    def errors(
        self, accuracy: Accuracy, reference: dict[str, Array]
    ) -> tuple[ImageError, ImageError | None, GradientError | None]:
        """Distances of picture and gradients from the reference; see :class:`Point`."""
        picture = self.picture(accuracy)
        image = image_error(picture, reference["image"])
        if accuracy.downscale > 1:
            return image, None, None
        stopped = image_error(picture, self.picture(without_stop(accuracy)).astype(np.float64))
        found = self.gradients(accuracy)
        names = [name for name in reference if name != "image"]
        pairs = {
            name: (self.device.download(getattr(found, name)), reference[name]) for name in names
        }
        gradient = GradientError(
            {name: relative_l2(*pair) for name, pair in pairs.items()},
            {name: element_error(*pair) for name, pair in pairs.items()},
        )
        return image, stopped, gradient


def image_error(image: npt.NDArray[np.float32], reference: Array) -> ImageError:
    """Error of a picture (3, H, W); NaN spreads."""
    error = np.abs(image.astype(np.float64) - reference)
    with np.errstate(divide="ignore"):
        psnr = -10 * np.log10(np.mean(error**2))
    return ImageError(255 * float(np.quantile(error, 0.999)), 255 * float(error.max()), float(psnr))


def element_error(actual: npt.NDArray[np.float32], expected: Array) -> float:
    """99th percentile of |error| / max(|expected|, rms / 1000) if either is not zero."""
    rms = float(np.sqrt(np.mean(expected**2)))
    touched = (expected != 0) | (actual != 0)
    if not touched.any():
        return 0.0
    wanted = expected[touched]
    error = np.abs(actual[touched].astype(np.float64) - wanted)
    return float(np.quantile(error / np.maximum(np.abs(wanted), rms / 1000), 0.99))


def _take_turns(
    bench: _Bench, accuracies: list[Accuracy], repeats: int
) -> dict[Accuracy, tuple[Times, Times | None]]:
    """Times of forward, and of forward and backward; only the former if renders are small."""
    forward: dict[Accuracy, list[float]] = {one: [] for one in accuracies}
    both: dict[Accuracy, list[float]] = {one: [] for one in accuracies}
    for turn in range(WARM_UP + repeats):
        for one in accuracies:
            ahead = _milliseconds(bench.device, partial(bench.picture, one))
            forward[one] += [ahead] if turn >= WARM_UP else []
            if one.downscale == 1:
                whole = _milliseconds(bench.device, partial(bench.gradients, one))
                both[one] += [whole] if turn >= WARM_UP else []
    return {one: (_times(forward[one]), _times(both[one]) if both[one] else None) for one in both}


def _milliseconds(device: Device, work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    device.finish()
    return 1e3 * (time.perf_counter() - start)


def _times(milliseconds: list[float]) -> Times:
    low, median, high = np.quantile(milliseconds, [0.05, 0.5, 0.95])
    return Times(float(median), float(low), float(high))


def fastest_within(figures: SceneFigures) -> dict[str, dict[str, object]]:
    """Find the fastest forward pass within every goal, by p99.9 and by the largest error."""
    found: dict[str, dict[str, object]] = {}
    for measure in ("p999", "largest"):
        for goal in GOALS:
            within = [one for one in figures.points if getattr(one.image, measure) <= goal]
            best = min(within, key=lambda one: one.forward.median, default=None)
            found[f"{measure} <= {goal:g} level"] = {
                "milliseconds": best.forward.median if best else None,
                "setting": f"{best.sweep} {best.label}" if best else None,
            }
    return found


def against_parity(figures: SceneFigures) -> dict[str, dict[str, float | None]]:
    """How many times faster each preset is than "parity", forward and with gradients."""
    presets = {one.label: one for one in figures.points if one.sweep == PRESET_SWEEP}
    parity = presets["parity"]
    return {
        label: {
            "forward": parity.forward.median / one.forward.median,
            "both": parity.both.median / one.both.median if parity.both and one.both else None,
            "largest": one.stopped.largest if one.stopped else None,
        }
        for label, one in presets.items()
    }
