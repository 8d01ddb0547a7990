"""Alpha and transmittance: families N13, N15, N16 and N17; N14 is in tests/ops/test_blend.py."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.lab.kernels import blend_decisions
from clgs.lab.scenes import anchor_scene
from clgs.opencl import programs
from clgs.opencl.device import Device
from clgs.render.frame import upload_scene, upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.scene.scene import RenderSettings
from tests.gaussians import projected_scene
from tests.ops.cases.blend import BACKGROUND, render
from tests.stress.cases import (
    GRADIENTS,
    assert_matches,
    changed,
    decided,
    draw,
    gradients,
    image_gradient,
    part,
    space_scene,
    straight_camera,
)

CAMERA = straight_camera(32, 32)
D_IMAGE = image_gradient(CAMERA)


@pytest.mark.slow
@pytest.mark.family("N13")
@pytest.mark.parametrize(
    ("count", "opacity"),
    [(2, 1.0), (16, 0.9899), (16, 0.99), (16, 0.9901), (2000, 0.5), (2000, 0.999)],
)
def test_coincident_splats(device, count, opacity):
    scene = part(space_scene(np.random.default_rng(0), 1, CAMERA, 8.0), np.zeros(count, int))
    scene = changed(changed(scene, "mean", slice(None), 0.03), "opacity", slice(None), opacity)
    scene = replace(scene, color=np.random.default_rng(1).random((count, 3), np.float32))
    # T of a pixel with 1,500 layers is off by 5e-6 (measured), and all splats share its error
    assert_matches(draw(device, scene, CAMERA), D_IMAGE, gradient=2e-5 if count > 200 else 1e-5)


@pytest.fixture(scope="module", params=["", "-cl-mad-enable"])
def options_device(request, device):
    """A device whose kernels are built with one more option."""
    if not request.param:
        yield device
        return
    with pytest.MonkeyPatch.context() as patch:
        options = (*programs.BUILD_OPTIONS, request.param)
        patch.setattr(programs, "BUILD_OPTIONS", options)
        yield Device(specialisation=device.specialisation)


def mismatches(device, scene, size, d_image) -> tuple[int, int]:
    """(pairs on which forward and backward disagree, pairs): contributors and saturation."""
    rendered = render(device, scene, size)
    one, other = blend_decisions(device, rendered.blended, device.upload(d_image))
    wrong = np.count_nonzero(one.contributed != other.contributed)
    wrong += np.count_nonzero(one.saturated != other.saturated)
    return int(wrong), one.contributed.size


def agreement(device, seed: int, count: int, size: tuple[int, int]) -> tuple[int, int]:
    rng = np.random.default_rng(seed)
    sigma, ratio = rng.choice([0.7, 1.5, 4.0, 12.0]), rng.choice([1.0, 5.0, 100.0])
    scene = projected_scene(rng, count, *size, sigma, ratio)
    # near the thresholds: alpha at the cut, at saturation, and many layers at the stop
    scene.opacity[::3] = np.float32(1 / 255) * rng.uniform(1, 1.0001, len(scene.opacity[::3]))
    scene.opacity[1::3] = rng.uniform(0.985, 0.995, len(scene.opacity[1::3]))
    d_image = rng.normal(size=(3, size[1], size[0])).astype(np.float32)
    return mismatches(device, scene, size, d_image)


@pytest.mark.slow
@pytest.mark.family("N15")
@pytest.mark.parametrize("seed", range(3))
def test_forward_and_backward_decide_alike(options_device, seed):
    wrong, pairs = agreement(options_device, seed, 600, (64, 48))
    assert wrong == 0
    assert pairs > 100_000


@pytest.mark.release
@pytest.mark.family("N15")
def test_forward_and_backward_decide_alike_on_1e8_pairs(options_device):
    total, seed = 0, 100
    while total < 10**8:
        wrong, pairs = agreement(options_device, seed, 20_000, (256, 256))
        assert wrong == 0, seed
        total, seed = total + pairs, seed + 1


@pytest.mark.family("N16")
@pytest.mark.parametrize("opacity", [1.001 / 255, 0.005, 0.5])
@pytest.mark.parametrize("sigma", [0.3, 5.0])
def test_whatever_is_drawn_gets_an_opacity_gradient(device, sigma, opacity):
    """After a reset to a faint opacity, as at any other: support alone decides."""
    scene = space_scene(np.random.default_rng(4), 300, CAMERA, sigma)
    drawn = draw(device, changed(scene, "opacity", slice(None), opacity), CAMERA)
    lists = drawn.rendered.inputs["tiles"]
    made = decided(drawn, D_IMAGE)
    free = (made.contributed & ~made.saturated).any(axis=1)
    supported = np.zeros(300, bool)
    supported[device.download(lists.gaussian)[free]] = True
    d_opacity = gradients(drawn, D_IMAGE)["d_opacity"]
    assert np.mean(d_opacity[supported] == 0) <= 1e-3 if supported.any() else opacity < 0.004
    assert not d_opacity[~supported].any()


def background_only(drawn) -> bool:
    shape = (1, drawn.size[1], drawn.size[0])
    return np.array_equal(drawn.image, np.tile(BACKGROUND[:, None, None], shape))


INVISIBLE = {
    "behind": lambda scene: changed(scene, "mean", (slice(None), 2), -9),
    "at the side": lambda scene: changed(scene, "mean", (slice(None), 0), 1e3),
    "far away": lambda scene: changed(scene, "mean", slice(None), 1e30),
    "transparent": lambda scene: changed(scene, "opacity", slice(None), 0.0),
    "below the cut": lambda scene: changed(scene, "opacity", slice(None), 0.0039),
    "no rotation": lambda scene: changed(scene, "rotation", slice(None), 0),
    "not numbers": lambda scene: changed(scene, "mean", slice(None), np.nan),
}


@pytest.mark.family("N17")
@pytest.mark.parametrize("reason", INVISIBLE)
@pytest.mark.parametrize("count", [0, 65])
def test_nothing_visible(device, count, reason):
    scene = space_scene(np.random.default_rng(0), max(count, 1), CAMERA)
    drawn = draw(device, part(INVISIBLE[reason](scene), np.arange(count)), CAMERA)
    assert background_only(drawn)
    found = gradients(drawn, D_IMAGE)
    for name in GRADIENTS:
        assert len(found[name]) == count
        assert not found[name].any(), name


@pytest.mark.family("N17")
@pytest.mark.parametrize("alone", [0, 4])
def test_one_visible_among_many(device, alone):
    scene = space_scene(np.random.default_rng(0), 65, CAMERA, spread=0.4)
    hidden = INVISIBLE["behind"](scene)
    hidden.mean[13 * alone] = scene.mean[13 * alone]
    drawn = draw(device, hidden, CAMERA)
    assert drawn.visible.sum() == 1
    # a single splat's gradient may nearly cancel over its pixels
    assert_matches(drawn, D_IMAGE, gradient=3e-5)
    single = draw(device, part(scene, [13 * alone]), CAMERA)
    assert np.array_equal(drawn.image, single.image)


@pytest.mark.family("N17")
@pytest.mark.parametrize("move", [(0, 0, -9), (1e3, 0, 0), (np.nan, 0, 0)])
def test_no_visible_anchor(device, move):
    scene, camera = anchor_scene(160, 32, 5)
    scene.anchors.position[:] = np.float32(move)
    uploaded = upload_scene(device, scene)
    frame = rasterise(
        device, uploaded, upload_view(device, camera, RenderSettings(background=(0.2, 0.5, 0.9)))
    )
    wanted = np.tile(np.float32([0.2, 0.5, 0.9])[:, None, None], (1, 32, 32))
    assert np.array_equal(device.download(frame.image), wanted)
    found = rasterise_backward(device, uploaded, frame, device.upload(D_IMAGE), 0.01)
    for name in ("d_offset", "d_feature", "d_scaling", "d_weights"):
        assert not device.download(getattr(found, name)).any(), name
