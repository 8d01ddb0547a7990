"""What a render costs, and how far it is from one without truncation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import numpy.typing as npt

from clgs.cli.tell import tell
from clgs.errors import UsageError
from clgs.lab.figures import take_turns
from clgs.lab.scenes import anchor_scene
from clgs.lab.selftest.reference_render import cached_reference, relative_l2
from clgs.opencl.device import Device
from clgs.options import PRESETS, Accuracy, RenderOptions
from clgs.render.frame import SceneGradients, upload_scene, upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import Scene

Array = npt.NDArray[np.float64]

PRESET_SWEEP = "preset"
FINE = Accuracy("", alpha_cut=2.0**-16, transmittance_stop=1e-6, inclusive_stop=True)
"""Around which sweeps turn one knob: its error must not drown in those of the others."""

CUTS = (255, 512, 1024, 4096, 16384, 65536)
STOPS = (("1e-6", 1e-6), ("1e-4", 1e-4), ("1e-3", 1e-3), ("1/512", 1 / 512), ("1/255", 1 / 255))
DEGREES = (3, 4, 5, 6)
EXTENTS = (0.0, 1.0, 2.0, 3.0)

SYNTHETIC = {
    "small": (100_000, 400, 0.0),
    "dense": (100_000, 200, 0.0),
    "large": (8000, 400, 1.2),
    "tiny": (2000, 64, 0.0),
}
"""Gaussians, pixels of the edge, and what is added to the log scales, by name."""

WARM_UP = 2


@dataclass(frozen=True)
class Setting:
    """One point of the plot: the sweep that it belongs to, its name there, what is truncated."""

    sweep: str
    label: str
    accuracy: Accuracy


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


def accuracy_settings(sweeps: Sequence[str] = ()) -> list[Setting]:
    """List every preset, and sweeps of one knob, with the others as in FINE.

    Args:
        sweeps: names of the sweeps to list, in addition to the presets; empty: all.

    Raises:
        UsageError: there is no such sweep.
    """
    settings = [Setting(PRESET_SWEEP, name, accuracy) for name, accuracy in PRESETS.items()]

    def add(sweep: str, label: str, **knobs: float | bool) -> None:
        settings.append(Setting(sweep, label, replace(FINE, **knobs)))  # type: ignore[arg-type]

    for share in CUTS:
        add("alpha cut", f"1/{share}", alpha_cut=1 / share)
    for inclusive in (False, True):
        for label, stop in STOPS:
            sweep = f"{'inclusive' if inclusive else 'exclusive'} stop"
            add(sweep, label, transmittance_stop=stop, inclusive_stop=inclusive)
    for degree in DEGREES:
        add("exp2 degree", str(degree), exp2_degree=degree)
    for extent in EXTENTS:
        add("least extent", f"{extent:g} px", min_extent=extent)
    add("resolution", "full", downscale=1)
    add("resolution", "1/2", downscale=2)
    names = list(dict.fromkeys(one.sweep for one in settings))
    for sweep in sweeps:
        if sweep not in names:
            raise UsageError(f"no sweep {sweep!r}; there are {', '.join(names)}")
    return [one for one in settings if not sweeps or one.sweep in (PRESET_SWEEP, *sweeps)]


def synthetic_subjects(names: Sequence[str], seed: int) -> list[tuple[str, Scene, Camera]]:
    """The seeded scenes of the given names, each with a view of it."""
    subjects = []
    for name in names:
        gaussians, size, growth = SYNTHETIC[name]
        scene, camera = anchor_scene(gaussians, size, seed)
        anchors = replace(scene.anchors, scaling=scene.anchors.scaling + np.float32(growth))
        subjects.append((name, replace(scene, anchors=anchors), camera))
    return subjects


def bench_accuracy(
    device: Device,
    name: str,
    subject: Scene,
    camera: Camera,
    settings: Sequence[Setting],
    repeats: int,
) -> SceneFigures:
    """Errors of every setting, then times, the settings taking turns ``repeats`` times.

    ``name``: of ``subject``, which ``camera`` looks at.
    Gradients are those of the sum of the picture times a random array.
    """
    render_settings = subject.settings
    scene, view = upload_scene(device, subject), upload_view(device, camera, render_settings)
    size = (camera.width, camera.height)
    d_host = np.random.default_rng(1).normal(size=(3, *size[::-1])).astype(np.float32)
    d_image = device.upload(d_host)
    background = np.array(render_settings.background, np.float32)
    packed = camera.pack(render_settings.near)
    reference = cached_reference(subject, packed, size, background, d_host)

    @cache
    def picture_of(accuracy: Accuracy) -> Callable[[], npt.NDArray[np.float32]]:
        """Render on the host, like `clgs render`."""
        options = RenderOptions(accuracy)
        renderer = Renderer.of_device_scene(device, scene, render_settings, options)
        return partial(renderer.render, camera)

    def gradients(accuracy: Accuracy) -> SceneGradients:
        """Compute gradients on the device, like a training step."""
        frame = rasterise(device, scene, view, RenderOptions(accuracy))
        found = rasterise_backward(device, scene, frame, d_image)
        device.finish()
        return found

    def errors(accuracy: Accuracy) -> tuple[ImageError, ImageError | None, GradientError | None]:
        """Distances of picture and gradients from the reference; see :class:`Point`."""
        drawn = picture_of(accuracy)()
        image = image_error(drawn, reference["image"])
        if accuracy.downscale > 1:
            return image, None, None
        without_stop = replace(
            accuracy, transmittance_stop=1e-9, inclusive_stop=True, exp2_degree=max(DEGREES)
        )
        stopped = image_error(drawn, picture_of(without_stop)().astype(np.float64))
        return image, stopped, gradient_error(device, gradients(accuracy), reference)

    tell(f"clgs: {name}: errors of {len(settings)} settings")
    different = list(dict.fromkeys(replace(one.accuracy, name="") for one in settings))
    errors_of = {accuracy: errors(accuracy) for accuracy in different}
    tell(f"clgs: {name}: times of {len(different)} different ones, {repeats} rounds")
    tasks: dict[tuple[Accuracy, bool], Callable[[], object]] = {}
    for one in different:
        tasks[one, False] = picture_of(one)
        if one.downscale == 1:
            tasks[one, True] = partial(gradients, one)
    times = {}
    for key, milliseconds in take_turns(tasks, repeats, WARM_UP).items():
        low, median, high = np.quantile(milliseconds, [0.05, 0.5, 0.95])
        times[key] = Times(float(median), float(low), float(high))
    points = []
    for setting in settings:
        accuracy = replace(setting.accuracy, name="")
        image, stopped, gradient = errors_of[accuracy]
        forward, both = times[accuracy, False], times.get((accuracy, True))
        points.append(Point(setting.sweep, setting.label, forward, image, stopped, both, gradient))
    frame = rasterise(device, scene, view)
    counts = len(subject.anchors), len(frame.gaussians), len(frame.tiles.gaussian)
    return SceneFigures(name, *counts, size, points)


def image_error(image: npt.NDArray[np.float32], reference: Array) -> ImageError:
    """Error of a picture (3, H, W); NaN spreads."""
    error = np.abs(image.astype(np.float64) - reference)
    with np.errstate(divide="ignore"):
        psnr = -10 * np.log10(np.mean(error**2))
    return ImageError(255 * float(np.quantile(error, 0.999)), 255 * float(error.max()), float(psnr))


def gradient_error(
    device: Device, found: SceneGradients, reference: dict[str, Array]
) -> GradientError:
    """Errors of the gradients that ``reference`` names."""
    pairs = {
        name: (device.download(getattr(found, name)), wanted)
        for name, wanted in reference.items()
        if name != "image"
    }
    return GradientError(
        {name: relative_l2(*pair) for name, pair in pairs.items()},
        {name: element_error(*pair) for name, pair in pairs.items()},
    )


def element_error(actual: npt.NDArray[np.float32], expected: Array) -> float:
    """99th percentile of |error| / max(|expected|, rms / 1000) if either is not zero."""
    rms = float(np.sqrt(np.mean(expected**2)))
    touched = (expected != 0) | (actual != 0)
    if not touched.any():
        return 0.0
    wanted = expected[touched]
    error = np.abs(actual[touched].astype(np.float64) - wanted)
    return float(np.quantile(error / np.maximum(np.abs(wanted), rms / 1000), 0.99))


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
