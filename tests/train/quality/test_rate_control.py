"""Smaller files without training: importance against leaving anchors out, sizes, PSNR."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from clgs.codec.scene_encoder import encode, sort_anchors
from clgs.codec.smaller import take
from clgs.data.images import Pixels
from clgs.data.view import StoredPhoto, View
from clgs.errors import UsageError
from clgs.lab.scenes import anchor_scene
from clgs.opencl.device import Device
from clgs.options import DEFAULT
from clgs.render.frame import upload_scene
from clgs.render.renderer import Renderer
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene
from clgs.train.quality.importance import (
    Sensitivity,
    feature_products,
    importance_without_views,
    sensitivity,
)
from clgs.train.quality.rate_control import SceneJudge, reduce_to_psnr, reduce_to_size, spread
from clgs.train.quality.scores import to_8bit
from tests.codec.scenes import random_scene


def fast(scene: QuantizedScene) -> bytes:
    return encode(scene, "fast", threads=1)


@pytest.fixture(scope="module")
def seen(device):
    """A scene of integers, and a noisy photo of it: about 42 dB."""
    scene, camera = anchor_scene(1200, 64)
    scales = QuantizationScales(position=2000.0, offset=16.0, feature=16.0, scaling=16.0)
    integers = (
        np.rint(getattr(scene.anchors, name) * scale).astype(np.int32)
        for name, scale in vars(scales).items()
    )
    anchors = sort_anchors(QuantizedAnchors(*integers))
    quantized = QuantizedScene(anchors, scene.mlps, scales, scene.settings, scene.transform)
    image = to_8bit(Renderer(device, quantized.dequantize()).render(camera))
    noise = np.random.default_rng(1).integers(-4, 5, image.shape)
    image = np.clip(image + noise, 0, 255).astype(np.uint8)
    return quantized, View("front", camera, StoredPhoto.of(Pixels(image, None)))


def importance(
    device: Device, scene: QuantizedScene, cameras: list[Camera]
) -> npt.NDArray[np.float32]:
    uploaded = upload_scene(device, scene.dequantize())
    return sensitivity(device, uploaded, scene.settings, cameras, curved=False).importance


def without(
    device: Device, scene: QuantizedScene, view: View, anchor: int
) -> npt.NDArray[np.float32]:
    """The picture without one anchor."""
    left = take(scene, np.delete(np.arange(len(scene.anchors)), anchor))
    return Renderer(device, left.dequantize()).render(view.camera)


def test_importance_is_what_leaving_out_costs(device, seen, rng):
    scene, view = seen
    repeats = 24
    estimate = importance(device, scene, [view.camera] * repeats) / repeats
    whole = Renderer(device, scene.dequantize()).render(view.camera)
    some = rng.permutation(len(scene.anchors))[:24]
    exact = [float(np.square(without(device, scene, view, i) - whole).sum()) for i in some]
    # 24 draws have a standard error of sqrt(2 / 24) = 0.29; single removals are exact but for the
    # clamp of alpha, the cuts and the overlap of an anchor's own Gaussians.
    matters = np.array(exact) > 1e-3
    assert matters.sum() >= 6
    ratio = estimate[some][matters] / np.array(exact)[matters]
    assert 0.7 < np.median(ratio) < 1.4
    assert (np.abs(np.log(ratio)) < np.log(4)).all()


def test_importance_is_the_same_every_time(device, seen):
    scene, view = seen
    first, second = (importance(device, scene, [view.camera]) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert (first >= 0).all()


def test_products_are_what_errors_of_features_cost(device, seen):
    """All features of a random half of the anchors move by e, those of the others by -e."""
    scene, view = seen
    floats, e = scene.dequantize(), np.full(50, 0.05)
    e[::3] *= -2.0
    shared = device, upload_scene(device, floats), scene.settings
    repeats = 24
    products = feature_products(*shared, [view.camera] * repeats) / repeats
    np.testing.assert_array_equal(products, products.T)
    whole = Renderer(device, floats).render(view.camera)
    rng, exact = np.random.default_rng(3), []
    for _ in range(repeats):
        signs = rng.choice([-1.0, 1.0], len(scene.anchors))
        feature = (floats.anchors.feature + signs[:, None] * e).astype(np.float32)
        moved = replace(floats, anchors=replace(floats.anchors, feature=feature))
        exact.append(np.square(Renderer(device, moved).render(view.camera) - whole).sum())
    assert 0.7 < e @ products @ e / np.mean(exact) < 1.4


def test_without_views_coarser_integers_come_before_fewer_anchors(seen):
    scene, _ = seen
    target = int(0.97 * len(fast(scene)))
    found = reduce_to_size(scene, target, fast, None)
    assert len(found.scene.anchors) == len(scene.anchors)
    assert max(found.factors.values()) < 1
    assert 0.99 * target <= len(found.data) <= target


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.95, 0.75])
def test_a_size_is_met_and_the_useful_kept(device, seen, share):
    scene, view = seen
    judge = SceneJudge(device, [view] * 4, [view])
    target = int(share * len(fast(scene)))
    found = reduce_to_size(scene, target, fast, judge)
    assert 0.98 * target <= len(found.data) <= target
    assert found.data == fast(found.scene)
    assert found.psnr is not None
    before, after = found.psnr
    assert after == judge.psnr(found.scene)
    blind = reduce_to_size(scene, target, fast, None)
    assert blind.psnr is None
    assert 0.98 * target <= len(blind.data) <= target
    assert before > after > judge.psnr(blind.scene)


def test_a_scene_that_fits_is_left_alone(device, seen):
    scene, view = seen
    found = reduce_to_size(scene, len(fast(scene)), fast, SceneJudge(device, [view], [view]))
    assert found.scene is scene
    assert found.psnr is not None
    assert found.psnr[0] == found.psnr[1]


def test_a_psnr_is_kept_in_fewer_bytes(device, seen, monkeypatch):
    scene, view = seen
    judge = SceneJudge(device, [view], [view])
    whole = judge.psnr(scene)
    found = reduce_to_psnr(scene, whole - 6.0, fast, judge)
    assert found.psnr == (whole, judge.psnr(found.scene))
    assert found.psnr[1] >= whole - 6.0
    assert found.data == fast(found.scene)
    smaller = reduce_to_psnr(scene, whole - 14.0, fast, judge)
    assert len(smaller.data) < len(found.data) < len(fast(scene))
    monkeypatch.setattr("clgs.train.quality.rate_control.SIZE_STEPS", 0)
    alone = reduce_to_psnr(scene, whole - 6.0, fast, judge)  # by fewer anchors alone
    assert len(alone.scene.anchors) < len(scene.anchors)
    assert alone.factors == {}
    assert len(found.data) < len(alone.data)
    with pytest.raises(UsageError, match="the whole scene has"):
        reduce_to_psnr(scene, whole + 0.1, fast, judge)


@pytest.mark.slow
def test_the_same_bytes_every_time(device, seen):
    scene, view = seen
    target = int(0.8 * len(fast(scene)))
    judge = SceneJudge(device, [view] * 2, [view])
    first, second = (reduce_to_size(scene, target, fast, judge) for _ in range(2))
    assert first.data == second.data
    assert first.psnr == second.psnr


@pytest.mark.parametrize("tight", [1, 2])
def test_nearly_the_whole_file_is_met(device, seen, tight):
    scene, view = seen
    target = len(fast(scene)) - tight
    found = reduce_to_size(scene, target, fast, SceneJudge(device, [view], [view]))
    assert 0.98 * target <= len(found.data) <= target


def test_what_cannot_be_reached_is_refused_before_rendering(device, seen):
    scene, view = seen
    renders: list[None] = []
    judge = SceneJudge(device, [view], [view], on_render=lambda: renders.append(None))
    with pytest.raises(UsageError, match="a file of 100 bytes is too small"):
        reduce_to_size(scene, 100, fast, judge)
    assert not renders
    reduce_to_size(scene, int(0.9 * len(fast(scene))), fast, judge)
    assert renders


def test_pictures_with_room_are_judged_at_half_the_resolution(device, seen, monkeypatch):
    scene, view = seen
    widths: list[int] = []

    def note(*arguments: object) -> Sensitivity:
        cameras = arguments[3]
        assert isinstance(cameras, list)
        widths.extend(camera.width for camera in cameras)
        return Sensitivity(np.zeros(len(scene.anchors), np.float32), {}, np.zeros(0, np.bool_))

    monkeypatch.setattr("clgs.train.quality.rate_control.sensitivity", note)
    # Two pixels an anchor remain of the larger one.
    side = int(np.ceil(np.sqrt(8 * len(scene.anchors))))
    views = [replace(view, camera=view.camera.resized(size, size)) for size in (side - 1, side)]
    SceneJudge(device, views, [view]).importance(scene)
    assert widths == [side - 1, round(side / 2)]


def test_masked_pixels_make_nothing_important(device, seen):
    """A masked half of the picture: what it alone shows is the first to go."""
    scene, view = seen
    mask = np.ones((64, 64), np.uint8)
    mask[:, 32:] = 0
    uploaded = upload_scene(device, scene.dequantize())
    shared = device, uploaded, scene.settings, [view.camera] * 8, DEFAULT, True
    whole, half = (sensitivity(*shared, used=used) for used in ((), [mask] * 8))
    x = view.camera.rotation[0] @ (scene.dequantize().anchors.position - view.camera.centre).T
    right, left = x > 0.5, x < -0.5
    assert half.importance[right].sum() < 0.05 * whole.importance[right].sum()
    assert half.importance[left].sum() > 0.9 * whole.importance[left].sum()
    assert half.curvature["feature"][right].sum() < 0.05 * whole.curvature["feature"][right].sum()


def test_without_views_large_anchors_come_first(seen):
    useful = importance_without_views(seen[0])
    shape = np.sort(seen[0].anchors.scaling[:, 3:], axis=1)[:, 1:].sum(axis=1)
    assert (np.diff(shape[np.argsort(useful, kind="stable")]) >= 0).all()


class Counting(SceneJudge):
    """Every anchor is worth a decibel more than none has."""

    def psnr(self, scene: QuantizedScene, count: int | None = None) -> float:
        return 7.0 + len(scene.anchors)

    def importance(self, scene: QuantizedScene) -> npt.NDArray[np.float64]:
        return np.ones(len(scene.anchors))


@pytest.mark.parametrize("anchors", [1, 2, 3, 53])
def test_the_fewest_anchors_are_found_however_few(device, anchors):
    scene = random_scene(np.random.default_rng(2), 20_000)
    judge = Counting(device, [], [])
    found = reduce_to_psnr(scene, 7.0 + anchors, lambda _: b"", judge)
    assert anchors <= len(found.scene.anchors) <= anchors + anchors // 32
    assert found.psnr == (7.0 + len(scene.anchors), 7.0 + len(found.scene.anchors))


def test_a_psnr_that_needs_no_anchor_is_refused(device, seen):
    """A size that no file meets is refused likewise; both say what a file without anchors has."""
    scene, view = seen
    judge = SceneJudge(device, [view], [view])
    least = judge.psnr(take(scene, np.arange(0)))
    said = rf"^1 dB is too little: {least:.2f} dB remain without anchors; ask for more$"
    with pytest.raises(UsageError, match=said):
        reduce_to_psnr(scene, 1.0, fast, judge)
    found = reduce_to_psnr(scene, least + 0.1, fast, judge)
    assert found.psnr is not None
    assert found.psnr[1] >= least + 0.1


def chosen(centres: list[float], count: int) -> list[int]:
    """The numbers of the views that are chosen of some on a line."""
    size, photo = (10.0, 10.0, 4.0, 4.0, 8, 8), Pixels(np.zeros((8, 8, 3), np.uint8), None)
    cameras = [Camera(np.eye(3), np.array([-x, 0.0, 0.0]), *size) for x in centres]
    views = [View(str(i), one, StoredPhoto.of(photo)) for i, one in enumerate(cameras)]
    return [int(view.name) for view in spread(views, count)]


def test_the_farthest_come_first():
    line = [0.0, 1.0, 2.0, 3.0, 10.0, 11.0, 5.0]
    assert chosen(line, 1) == [0]
    assert chosen(line, 2) == [0, 5]
    assert chosen(line, 3) == [0, 5, 6]
    assert chosen(line, 4) == [0, 2, 5, 6]


def test_no_camera_comes_twice():
    one_place = [1.0] * 5
    assert chosen(one_place, 3) == [0, 1, 2]
    assert chosen(one_place, 9) == [0, 1, 2, 3, 4]
    assert chosen([], 3) == []
