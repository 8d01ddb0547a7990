"""Run every stage on a device and compare it with its float64 reference."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from clgs.constants import ALPHA_CUT, TILE_SIZE
from clgs.lab.kernels import drawn_output, drawn_rows
from clgs.lab.scenes import anchor_scene
from clgs.lab.selftest.reference_render import (
    Check,
    ReferenceFrame,
    backward_reference,
    failed,
    largest,
    relative_errors,
    relative_l2,
    render_reference,
)
from clgs.lab.selftest.training_checks import training_checks
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import loss as loss_op
from clgs.ops import mlp, project, project_anchors
from clgs.reference import cull, loss, tiles
from clgs.reference import project as reference_project
from clgs.render.frame import Frame, SceneGradients, upload_scene, upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.scene.scene import RenderSettings

SEED = 11
VOLUME_WEIGHT = 0.01
LEVEL = 1 / 255

ELSEWHERE = project.Screen(0.0, 0.0, 0.0, 5.0, 5.2, 0.8)
"""On it some Gaussians are larger and some are smaller than in the photos."""


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
class _Run:
    """The device's results for the self-test scene, with the float64 ones."""

    device: Device
    frame: Frame
    at_once: project.Projected
    elsewhere: project.Projected
    photo: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
    d_image: DeviceArray
    gradients: SceneGradients
    reference: ReferenceFrame


def selftest(device: Device, case: Case | None = None) -> Iterator[Check]:
    """Checks of all stages, in the order of the pipeline; by default, tiny ones on an emulator.

    A stage that raises is a failed check, and the others follow.
    """
    case = case or (TINY if device.is_emulator else Case())
    try:
        yield from _checks_of_render(device, case)
    except Exception as error:  # a driver may raise anything
        device.profile.enabled = False
        yield failed("render", error)
    yield from training_checks(device, case.count)


def _checks_of_render(device: Device, case: Case) -> Iterator[Check]:
    """The stages of a render, which need each other, and all gradients."""
    run = _run(device, case)
    times = {name: milliseconds for name, _, milliseconds, _ in device.profile.rows()}
    for stage, check in FORWARD_CHECKS.items():
        for quantity, error, limit in check(run):
            yield Check(stage.split(" ")[0], quantity, error, limit, times.get(stage, 0.0))
    # gradients of the parameters, through all backward kernels at once
    d_image = device.download(run.d_image).astype(np.float64)
    wanted = backward_reference(run.reference, d_image, VOLUME_WEIGHT)
    milliseconds = sum(value for name, value in times.items() if name.endswith("backward"))
    for name, expected in wanted.items():
        error = relative_l2(device.download(getattr(run.gradients, name)), expected)
        yield Check("backward", name, error, 1e-5, milliseconds)


def _run(device: Device, case: Case) -> _Run:
    scene, camera = anchor_scene(case.gaussians, case.size, SEED)
    uploaded = upload_scene(device, scene)
    shape = (3, case.size, case.size)
    photo = np.random.default_rng(SEED).integers(0, 256, shape).astype(np.uint8)
    target = device.upload(photo)
    settings = RenderSettings(background=(0.1, 0.2, 0.3))
    device.profile.clear()
    device.profile.enabled = True
    for _ in range(case.repeats):
        frame = rasterise(device, uploaded, upload_view(device, camera, settings))
        inputs = mlp.Inputs(uploaded.anchors, uploaded.weights, frame.view.camera)
        with device.stage("project_anchors"):
            at_once, _ = project_anchors.forward(device, inputs, frame.activations.visible)
        with device.stage("project elsewhere"):
            elsewhere = project.forward(
                device, frame.gaussians, frame.view.camera, screen=ELSEWHERE
            )
        with device.stage("loss"):
            compared = loss_op.forward(device, frame.image, target)
            d_image = loss_op.backward(device, frame.image, target, compared)
        gradients = rasterise_backward(device, uploaded, frame, d_image, VOLUME_WEIGHT)
    device.profile.enabled = False
    reference = render_reference(device, scene, frame, d_image)
    return _Run(device, frame, at_once, elsewhere, photo, d_image, gradients, reference)


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
    errors = relative_errors(run.device, mine, wanted, names)
    same = np.array_equal(run.device.download(mine.slot), wanted.slot)
    return [
        *((name, error, 1e-5) for name, error in errors.items()),
        ("slot", 0.0 if same else np.inf, 0.0),
    ]


def check_project(run: _Run) -> Found:
    """Projected Gaussians."""
    names = ("mean2d", "whitening", "depth", "extent")
    errors = relative_errors(run.device, run.frame.projected, run.reference.projected, names)
    return [(name, error, 1e-5) for name, error in errors.items()]


def check_project_anchors(run: _Run) -> Found:
    """The same Gaussians from anchors at once, as for pictures without gradients."""
    errors = relative_errors(
        run.device, run.at_once, run.reference.projected, ("mean2d", "whitening", "depth", "extent")
    )
    errors |= relative_errors(
        run.device, run.at_once, run.reference.gaussians, ("color", "opacity")
    )
    return [("what is on the screen", max(errors.values()), 1e-5)]


def check_elsewhere(run: _Run) -> Found:
    """Gaussians on a screen for which some of them are too near and some too far."""
    one, camera = run.reference.gaussians, run.reference.camera
    shape = one.mean, one.scale, one.rotation
    wanted = reference_project.forward(*shape, one.opacity, camera, screen=ELSEWHERE)
    errors = relative_errors(run.device, run.elsewhere, wanted, ("whitening", "extent"))
    shown = reference_project.shown_opacity(shape, one.opacity, camera, ELSEWHERE)
    error = relative_l2(run.device.download(run.elsewhere.opacity), shown)
    return [("what is on the screen", max(*errors.values(), error), 1e-5)]


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


FORWARD_CHECKS: dict[str, Callable[[_Run], Found]] = {
    "cull": check_cull,
    "mlp forward": check_mlp,
    "neural forward": check_neural,
    "project forward": check_project,
    "project_anchors": check_project_anchors,
    "project elsewhere": check_elsewhere,
    "tiles": check_tiles,
    "blend forward": check_blend,
    "loss": check_loss,
}
"""The key is the stage whose time is shown."""
