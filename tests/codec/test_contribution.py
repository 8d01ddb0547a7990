"""What anchors contribute, against a plain sum over single Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.smaller import contribution
from clgs.reference import mlp, neural
from clgs.scene.anchors import take
from tests.web.scenes import quantized_scene


@pytest.fixture(scope="module")
def scene():
    return quantized_scene(600, 64)


def test_what_a_camera_sees_is_opacity_times_pixels(scene):
    quantized, camera = scene
    found = contribution(quantized, [camera])
    floats = quantized.dequantize()
    a = {name: array.astype(np.float64) for name, array in floats.anchors.items()}
    rows = np.arange(len(a["position"]), dtype=np.int32)
    output = mlp.forward(
        a["feature"], a["position"], rows, floats.mlps.flat.astype(np.float64), camera.pack(0.2)
    ).output
    made = neural.forward(output, rows, a["position"], a["offset"], a["scaling"])
    wanted = np.zeros(len(rows))
    for mean, scale, opacity, slot in zip(
        made.mean, made.scale, made.opacity, made.slot, strict=True
    ):
        x, y, z = camera.rotation @ mean + camera.translation
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        inside = -9.6 < u < 73.6 and -9.6 < v < 73.6 and z > quantized.settings.near
        pixels = camera.fx * camera.fy / z**2 * np.prod(np.sort(scale)[1:])
        wanted[slot // 10] += inside * min(max(opacity, 0), 1) * min(pixels, 64 * 64)
    assert wanted.max() > 0
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    np.testing.assert_allclose(contribution(quantized, [camera] * 3), 3 * wanted, rtol=1e-9)


def test_without_cameras_it_grows_with_the_square_of_the_size(scene):
    quantized, _ = scene
    found = contribution(quantized)
    assert (found > 0).any()
    larger = quantized.anchors.scaling + np.array([0, 0, 0, 32, 32, 32], np.int32)  # times e
    grown = contribution(
        replace(quantized, anchors=replace(quantized.anchors, scaling=larger.astype(np.int32)))
    )
    np.testing.assert_allclose(grown, np.e**2 * found, rtol=1e-5)


def test_batches_do_not_matter_and_nothing_is_nothing(scene, monkeypatch):
    quantized, camera = scene
    whole = contribution(quantized, [camera])
    monkeypatch.setattr("clgs.codec.smaller.BATCH", 7)
    np.testing.assert_allclose(contribution(quantized, [camera]), whole, rtol=1e-12)
    empty = replace(quantized, anchors=take(quantized.anchors, slice(0, 0)))
    assert contribution(empty).shape == (0,)
