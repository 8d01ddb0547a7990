"""Weights of anchors in pictures, against float64 with the kernels' decisions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.constants import K_OFFSETS
from clgs.lab.scenes import anchor_scene
from clgs.lab.selftest.reference_render import render_reference
from clgs.reference import blend
from clgs.render.frame import upload_scene, upload_view
from clgs.render.rasterise import rasterise
from clgs.train.quality.importance import LEAST_WEIGHT, visibility
from tests.compare import relative_l2

SIZE = 64


@pytest.fixture(scope="module")
def drawn(device):
    """A scene, its camera, its copy on the device, and a mask of the left half."""
    scene, camera = anchor_scene(1500, SIZE, 3)
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[:, : SIZE // 2] = 1
    return scene, camera, upload_scene(device, scene), mask


def weights_of_reference(device, drawn):
    """Sums of alpha T per anchor over all pixels and over the mask, (A, 2) float64."""
    scene, camera, uploaded, mask = drawn
    frame = rasterise(device, uploaded, upload_view(device, camera, scene.settings))
    picked = np.stack([np.ones_like(mask), mask, np.zeros_like(mask)]).astype(np.float64)
    wide = render_reference(device, scene, frame, device.upload(picked.astype(np.float32)))
    gaussians = wide.gaussians
    d_color = blend.backward(
        *(wide.projected, gaussians.color, gaussians.opacity, wide.lists, wide.background),
        *(wide.decisions, picked),
    ).d_color
    found = np.zeros((len(scene.anchors), 2))
    np.add.at(found, wide.activations.visible[gaussians.slot // K_OFFSETS], d_color[:, :2])
    return found, device.download(frame.blended.transmittance)


def test_weights_agree_with_float64(device, drawn):
    scene, camera, uploaded, mask = drawn
    wanted, transmittance = weights_of_reference(device, drawn)
    found = visibility(device, uploaded, scene.settings, [camera], [mask])
    assert relative_l2(found.weight, wanted[:, 0]) <= 1e-5
    assert relative_l2(found.inside, wanted[:, 1]) <= 1e-5
    # what the anchors do not make up is background
    assert found.weight.sum() == pytest.approx((1 - transmittance).sum(dtype=np.float64), rel=1e-5)
    clear = np.abs(wanted[:, 0] - LEAST_WEIGHT) > 1e-4
    assert np.array_equal(found.views[clear], (wanted[clear, 0] >= LEAST_WEIGHT).astype(int))
    assert 0 < found.views.sum() < len(scene.anchors)


def test_pictures_without_mask_count_as_views_alone(device, drawn):
    scene, camera, uploaded, mask = drawn
    away = replace(camera, translation=np.array([0.0, 0.0, -50.0]))
    once = visibility(device, uploaded, scene.settings, [camera], [mask])
    more = visibility(device, uploaded, scene.settings, [camera, camera, away], [mask, None, mask])
    assert np.array_equal(more.views, 2 * once.views)
    assert np.array_equal(more.weight, once.weight)
    assert np.array_equal(more.inside, once.inside)
