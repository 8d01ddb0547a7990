"""Run every stage on a device and compare it with its float64 reference."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from clgs.constants import ALPHA_CUT, TILE_SIZE
from clgs.lab.observed_kernels import drawn_output, drawn_rows
from clgs.lab.selftest.reference_render import (
    ReferenceFrame,
    backward_reference,
    largest,
    relative_l2,
    render_reference,
)
from clgs.lab.selftest.training_checks import training_checks
from clgs.lab.synthetic.anchor_scene import anchor_scene
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import loss as loss_op
from clgs.reference import cull, loss, tiles
from clgs.render.frame import DeviceScene, Frame, SceneGradients, upload_scene, upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.scene.camera import Camera
from clgs.scene.scene import RenderSettings, Scene

SEED = 11
VOLUME_WEIGHT = 0.01
LEVEL = 1 / 255


@dataclass(frozen=True)
class Case:
    """How large the self-test is.

    gaussians: neural Gaussians drawn; size: pixels of the image's edge; count: numbers given to
    the stages outside of a render; repeats: runs to time.
    """

    gaussians: int = 3000
    size: int = 80
    count: int = 20_000
    repeats: int = 5


TINY = Case(gaussians=70, size=24, count=600, repeats=1)
"""The size on emulators."""


@dataclass(frozen=True)
class Check:
    """One quantity of one stage: its error, the limit, and the stage's median milliseconds.

    The stage passes if ``error <= limit``; NaN does not.
    """

    stage: str
    quantity: str
    error: float
    limit: float
    milliseconds: float

    @property
    def passed(self) -> bool:
        """Whether the error is a number within the limit."""
        return self.error <= self.limit

    @property
    def share(self) -> float:
        """The error in units of its limit; not a number if the error is not."""
        return self.error / self.limit if self.limit else self.error * np.inf if self.error else 0.0


@dataclass(frozen=True)
class _Run:
    """The device's results for the self-test scene, with the float64 ones."""

    device: Device
    scene: Scene
    uploaded: DeviceScene
    frame: Frame
    photo: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
    d_image: DeviceArray
    gradients: SceneGradients
    reference: ReferenceFrame


def selftest(device: Device, case: Case | None = None) -> Iterator[Check]:
    """Checks of all stages, in the order of the pipeline; by default, tiny ones on an emulator."""
    case = case or (TINY if device.is_emulator else Case())
    run = _run(device, case)
    times = {name: milliseconds for name, _, milliseconds, _ in device.profile.rows()}
    for stages, check in FORWARD_CHECKS:
        milliseconds = sum(times.get(name, 0.0) for name in stages.split("+"))
        for quantity, error, limit in check(run):
            yield Check(stages.split("+")[0].split(" ")[0], quantity, error, limit, milliseconds)
    yield from _gradient_checks(run, times)
    for stage, quantity, error, limit, milliseconds in training_checks(device, case.count):
        yield Check(stage, quantity, error, limit, milliseconds)


def _run(device: Device, case: Case) -> _Run:
    scene, camera = anchor_scene(case.gaussians, case.size, SEED)
    uploaded = upload_scene(device, scene)
    shape = (3, case.size, case.size)
    photo = np.random.default_rng(SEED).integers(0, 256, shape).astype(np.uint8)
    target = device.upload(photo)
    device.profile.clear()
    device.profile.enabled = True
    for _ in range(case.repeats):
        frame, d_image, gradients = _step(device, uploaded, camera, target)
    device.profile.enabled = False
    reference = render_reference(device, scene, frame, d_image)
    return _Run(device, scene, uploaded, frame, photo, d_image, gradients, reference)


def _step(
    device: Device, scene: DeviceScene, camera: Camera, target: DeviceArray
) -> tuple[Frame, DeviceArray, SceneGradients]:
    frame = rasterise(
        device, scene, upload_view(device, camera, RenderSettings(background=(0.1, 0.2, 0.3)))
    )
    with device.stage("loss"):
        compared = loss_op.forward(device, frame.image, target)
        d_image = loss_op.backward(device, frame.image, target, compared)
    return frame, d_image, rasterise_backward(device, scene, frame, d_image, VOLUME_WEIGHT)


Found = list[tuple[str, float, float]]


def check_cull(run: _Run) -> Found:
    """Which anchors are visible: no decision may differ."""
    mine = set(run.device.download(run.frame.activations.visible).tolist())
    wanted = cull.forward(
        run.reference.scene["position"], run.reference.scene["scaling"], run.reference.camera
    )
    return [("anchors decided differently", float(len(mine ^ set(wanted.tolist()))), 0.0)]


def check_mlp(run: _Run) -> Found:
    """Outputs of the MLPs, in the rows that are drawn."""
    output = drawn_output(run.device, run.frame.activations)
    wanted = np.where(drawn_rows(output), run.reference.activations.output, output)
    # 103 products of order one, each with its rounding
    return [("output", largest(output, wanted), 103 * 2.0**-22)]


def check_neural(run: _Run) -> Found:
    """Neural Gaussians and their slots."""
    mine, wanted = run.frame.gaussians, run.reference.gaussians
    names = ("mean", "scale", "rotation", "color", "opacity")
    found = [
        (name, relative_l2(run.device.download(getattr(mine, name)), getattr(wanted, name)), 1e-5)
        for name in names
    ]
    slots = run.device.download(mine.slot)
    return [*found, ("slot", 0.0 if np.array_equal(slots, wanted.slot) else np.inf, 0.0)]


def check_project(run: _Run) -> Found:
    """Projected Gaussians."""
    mine, wanted = run.frame.projected, run.reference.projected
    names = ("mean2d", "whitening", "depth", "extent")
    return [
        (name, relative_l2(run.device.download(getattr(mine, name)), getattr(wanted, name)), 1e-5)
        for name in names
    ]


def check_tiles(run: _Run) -> Found:
    """Every pair that touches a pixel centre must be listed; few others may be."""
    projected, opacity = run.reference.projected, run.reference.gaussians.opacity
    wanted = set(_entries(tiles.forward(projected, opacity, *run.frame.view.size)))
    mine = set(_entries(run.reference.lists))
    missing = sum(_touches(run, tile, index) for tile, index in wanted - mine)
    surplus = len(mine - wanted) / max(1, len(wanted))
    return [("entries missing", float(missing), 0.0), ("entries without need", surplus, 0.01)]


def _touches(run: _Run, tile: int, index: int) -> bool:
    """Whether alpha reaches ALPHA_CUT at a pixel centre of the tile."""
    columns = -(-run.frame.view.size[0] // TILE_SIZE)
    corner = np.array([tile % columns, tile // columns]) * TILE_SIZE
    centres = np.stack(np.meshgrid(*[np.arange(TILE_SIZE) + 0.5] * 2), -1) + corner
    r1, slope, r2 = run.reference.projected.whitening[index]
    dx, dy = np.moveaxis(centres - run.reference.projected.mean2d[index], -1, 0)
    power = 0.5 * ((dx * r1) ** 2 + ((dy - slope * dx) * r2) ** 2)
    alpha = run.reference.gaussians.opacity[index] * np.exp(-power)
    return bool(alpha.max() >= ALPHA_CUT * (1 + 1e-5))


def _entries(lists: tiles.TileLists) -> list[tuple[int, int]]:
    counts = np.diff(lists.tile_range)
    tile = np.repeat(np.arange(len(counts)), counts)
    return list(zip(tile.tolist(), np.asarray(lists.gaussian).tolist(), strict=True))


def check_blend(run: _Run) -> Found:
    """The picture, in levels of 1/255."""
    error = np.abs(run.device.download(run.frame.image) - run.reference.image) / LEVEL
    return [
        ("image p99.9, levels", float(np.quantile(error, 0.999)), 1e-3),
        ("image max, levels", float(error.max()), 5e-3),
    ]


def check_loss(run: _Run) -> Found:
    """Both losses, and the gradient by the picture."""
    image = run.device.download(run.frame.image).astype(np.float64)
    wanted = loss.backward(image, run.photo)
    compared = loss_op.forward(run.device, run.frame.image, run.device.upload(run.photo))
    value = compared.value(run.device)
    expected = loss.forward(image, run.photo)
    return [
        ("L1", abs(value.l1 - expected.l1), 1e-6),
        ("SSIM", abs(value.ssim - expected.ssim), 1e-6),
        ("d_image", relative_l2(run.device.download(run.d_image), wanted), 1e-5),
    ]


FORWARD_CHECKS: tuple[tuple[str, Callable[[_Run], Found]], ...] = (
    ("cull", check_cull),
    ("mlp forward", check_mlp),
    ("neural forward", check_neural),
    ("project forward", check_project),
    ("tiles", check_tiles),
    ("blend forward", check_blend),
    ("loss", check_loss),
)


def _gradient_checks(run: _Run, times: dict[str, float]) -> Iterator[Check]:
    """Gradients of the parameters, through all backward kernels at once."""
    d_image = run.device.download(run.d_image).astype(np.float64)
    wanted = backward_reference(run.reference, d_image, VOLUME_WEIGHT)
    milliseconds = sum(value for name, value in times.items() if name.endswith("backward"))
    for name, expected in wanted.items():
        actual = run.device.download(getattr(run.gradients, name))
        yield Check("backward", name, relative_l2(actual, expected), 1e-5, milliseconds)
