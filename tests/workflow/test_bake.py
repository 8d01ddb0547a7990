"""Baking a small scene: it looks alike, the same each time, and keeps its place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clgs.errors import DataError
from clgs.lab.scenes import anchor_scene
from clgs.render.frame import upload_scene, upload_view
from clgs.render.renderer import Renderer
from clgs.scene.scene import SceneTransform, SplatScene
from clgs.train.quality.scores import to_8bit
from clgs.workflow.bake import (
    VIEWS,
    BakeSettings,
    BakeView,
    bake,
    baked_loss,
    cameras_around,
    count_steps,
    evenly,
    in_order,
    without_faint,
)
from clgs.workflow.bake_fit import observe
from tests.exports.splats.cases import gaussians

SIZE = 64


@pytest.fixture(scope="module")
def device(open_device):
    """One form: the stages are tested in both."""
    return open_device("cpu")


@pytest.fixture(scope="module")
def views():
    scene, camera = anchor_scene(400, SIZE, 5)
    rotations = Rotation.from_euler("y", np.linspace(-0.2, 0.2, 6)[:, None]).as_matrix()
    cameras = (replace(camera, rotation=camera.rotation @ rotation) for rotation in rotations)
    return scene, [BakeView(one) for one in cameras]


@pytest.mark.slow
def test_contributions_add_up_to_the_picture(device, views):
    """Weights times colors have the sum of the picture over black, in every channel."""
    scene, (view, *_) = views
    black = replace(scene.settings, background=(0.0, 0.0, 0.0))
    on_device = upload_view(device, view.camera, black)
    (seen,) = observe(device, upload_scene(device, scene), [(on_device, None)])
    picture = Renderer(device, replace(scene, settings=black)).render(view.camera)
    total = (seen.weight[:, None].astype(np.float64) * seen.color).sum(axis=0)
    assert np.allclose(total, picture.sum(axis=(1, 2), dtype=np.float64), rtol=1e-4)
    assert len(np.unique(seen.slot)) == len(seen.slot)


@pytest.mark.slow
def test_refinement_brings_it_closer_and_repeats_bit_for_bit(device, views):
    scene, turned = views
    rough = bake(device, scene, turned, BakeSettings(1, 0))
    fine = bake(device, scene, turned, BakeSettings(1, 30))
    losses = [baked_loss(device, scene, one, turned) for one in (rough, fine)]
    assert losses[0].scene is None
    assert losses[1].baked > losses[0].baked > 15
    again = bake(device, scene, turned, BakeSettings(1, 30))
    for name, array in fine.items():
        assert np.array_equal(getattr(again, name), array), name


def test_antialiased_ones_are_right_from_afar(device, views):
    """A picture of a quarter of the size is the mean over pixels of the whole one."""
    scene, turned = views
    camera = turned[0].camera
    whole = Renderer(device, scene).render(camera).astype(np.float64)
    wanted, errors = whole.reshape(3, SIZE // 4, 4, SIZE // 4, 4).mean(axis=(2, 4)), []
    for antialiased in (True, False):
        baked = bake(device, scene, turned, BakeSettings(1, 30, antialiased))
        assert baked.antialiased == antialiased
        of_baked = Renderer(device, SplatScene(baked, scene.settings))
        assert np.mean((of_baked.render(camera) - whole) ** 2) < 0.01
        errors.append(np.mean((of_baked.render(camera.reduced(4)) - wanted) ** 2))
    assert errors[0] < 0.5 * errors[1]


@pytest.mark.slow
def test_photos_are_what_it_is_refined_to(device, views):
    scene, turned = views
    renderer = Renderer(device, scene)
    painted = []
    for view in turned:
        darker = to_8bit(0.8 * renderer.render(view.camera)).transpose(2, 0, 1)
        painted.append(replace(view, photo=lambda planes=darker: planes))
    found = bake(device, scene, painted, BakeSettings(0, 60))
    before = bake(device, scene, painted, BakeSettings(0, 0))
    losses = [baked_loss(device, scene, one, painted) for one in (before, found)]
    assert losses[0].scene == losses[1].scene is not None
    assert losses[1].baked > losses[0].baked + 1


def test_masked_pixels_enter_neither_fit_nor_refinement_nor_scores(device, views):
    """Nothing in the photos changes a bit there, and no Gaussian is left that only they show."""
    scene, turned = views
    renderer, used = Renderer(device, scene), np.zeros((SIZE, SIZE), np.uint8)
    used[:, : SIZE // 2] = 1
    found, losses = [], []
    for level in (0, 255):
        painted = []
        for view in turned[:2]:
            planes = to_8bit(renderer.render(view.camera)).transpose(2, 0, 1).copy()
            planes[:, used == 0] = level
            painted.append(BakeView(view.camera, lambda p=planes: p, lambda: used))
        found.append(bake(device, scene, painted, BakeSettings(1, 20)))
        losses.append(baked_loss(device, scene, found[-1], painted))
    for name, array in found[0].items():
        assert np.array_equal(getattr(found[1], name), array), name
    assert losses[0] == losses[1]
    assert losses[0].scene == np.inf
    assert losses[0].baked > 20
    whole = bake(device, scene, turned[:2], BakeSettings(1, 0))
    masked = bake(device, scene, painted, BakeSettings(1, 0))
    assert len(masked) < 0.8 * len(whole)
    shown = Renderer(device, SplatScene(found[0], scene.settings)).render(turned[0].camera)
    black = np.array(scene.settings.background)[:, None, None]
    beyond = np.abs(shown - black)[:, :, SIZE // 2 + 12 :]
    assert beyond.mean() < 0.02


def test_every_step_is_reported(device, views):
    scene, turned = views
    settings, steps = BakeSettings(0, 3), []
    bake(device, scene, turned, settings, on_step=lambda: steps.append(1))
    assert len(steps) == count_steps(len(turned), settings) == 2 * 6 + 3


def test_views_that_see_nothing_are_refused(device, views):
    scene, (view, *_) = views
    away = BakeView(replace(view.camera, translation=np.array([0.0, 0.0, -50.0])))
    with pytest.raises(DataError, match=r"no view sees anything of the scene; is --data"):
        bake(device, scene, [away], BakeSettings(0, 0))


def test_order_keeps_near_ones_together_and_loses_none():
    before = gaussians(0, 2000)
    after = in_order(before)
    rows = {tuple(row) for row in before.mean.tolist()}
    assert rows == {tuple(row) for row in after.mean.tolist()}
    steps = [np.linalg.norm(np.diff(one.mean, axis=0), axis=1).mean() for one in (before, after)]
    assert steps[1] < 0.5 * steps[0]
    one = in_order(before.map(lambda array: array[:1]))
    assert np.array_equal(one.mean, before.mean[:1])


def test_faint_ones_go():
    before = gaussians()
    assert before.opacity[2] < -6
    after = without_faint(before)
    assert len(after) < len(before)
    assert after.opacity.min() > -5.6


def test_views_are_chosen_evenly():
    assert evenly(list(range(10)), 3) == [0, 4, 9]
    assert evenly(list(range(3)), 5) == [0, 1, 2]


@pytest.mark.parametrize("transform", [SceneTransform(), SceneTransform((1.0, 2.0, 3.0), 2.0)])
def test_cameras_around_a_scene_look_at_it(views, transform):
    scene = replace(views[0], transform=transform)
    middle = np.median(scene.anchors.position, axis=0)
    cameras = cameras_around(scene)
    assert len(cameras) == VIEWS
    for camera in cameras:
        assert np.allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(camera.rotation) > 0
        point = camera.rotation @ middle + camera.translation
        assert np.allclose(point[:2], 0, atol=1e-6)
        assert point[2] > 0
