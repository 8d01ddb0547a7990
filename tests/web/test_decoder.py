"""The page's decoder, built for this machine: integers, Gaussians and order as they should be."""

from __future__ import annotations

import ctypes
import re
import shutil

import numpy as np
import pytest

from clgs import constants
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode
from clgs.reference.stages import mlp, neural
from clgs.reference.stages.project import rotation_matrix
from tests.codec.scenes import random_scene
from tests.web import native
from tests.web.scenes import quantized_scene

COMPILER = shutil.which("cc")
pytestmark = [
    pytest.mark.skipif(not (native.ROOT / "web/wasm").is_dir(), reason="needs a checkout"),
    pytest.mark.skipif(COMPILER is None, reason="needs a C compiler, cc"),
]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return native.build(tmp_path_factory.mktemp("native"), COMPILER)


@pytest.mark.parametrize("level", ["fast", "default", "max", "paper"])
@pytest.mark.parametrize("chunk", [16, 65_536])
def test_the_integers_are_those_of_the_file(library, level, chunk):
    data = encode(random_scene(np.random.default_rng(1), 3000), level=level, chunk=chunk)
    page = native.Page(library, data)
    expected = int.from_bytes(bytes.fromhex(describe(data)["content_hash"]), "little")
    assert page.hashes == [expected, expected]
    scene = decode(data).dequantize()
    found = page.array("positions", ctypes.c_float, scene.anchors.position.size)
    np.testing.assert_array_equal(found, scene.anchors.position.ravel())


def test_a_scene_without_anchors_has_no_gaussians(library):
    page = native.Page(library, encode(random_scene(np.random.default_rng(0), 0)))
    assert len(page.gaussians(np.zeros(3))["opacity"]) == 0
    assert len(page.order(np.ones(4))) == 0


def test_gaussians_are_those_of_the_reference(library):
    quantized, camera = quantized_scene(4000, 64)
    data = encode(quantized)
    scene = decode(data).dequantize()
    anchors = {name: array.astype(np.float64) for name, array in scene.anchors.items()}
    visible = np.arange(len(anchors["position"]), dtype=np.int32)
    weights, packed = scene.mlps.flat.astype(np.float64), camera.pack(0.2)
    made = mlp.forward(anchors["feature"], anchors["position"], visible, weights, packed)
    wanted = neural.forward(
        made.output, visible, anchors["position"], anchors["offset"], anchors["scaling"]
    )
    axes = rotation_matrix(wanted.rotation) * wanted.scale[:, None, :]
    drawn = wanted.opacity >= constants.ALPHA_CUT
    found = native.Page(library, data).gaussians(camera.centre)
    assert len(found["opacity"]) == drawn.sum()
    # Sums of 53 and 50 products in float32, and exponentials within 2e-7 of their values.
    np.testing.assert_allclose(found["mean"], wanted.mean[drawn], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found["opacity"], wanted.opacity[drawn], atol=1e-5)
    covariance = (axes @ axes.transpose(0, 2, 1))[drawn]
    largest = np.abs(covariance).max(axis=(1, 2), keepdims=True)
    assert np.abs((found["covariance"] - covariance) / largest).max() < 1e-4
    # Red and green are half floats: 11 bits.
    np.testing.assert_allclose(found["color"], wanted.color[drawn], atol=2.0**-11)


def test_the_order_is_by_depth_and_leaves_out_what_is_near(library):
    quantized, camera = quantized_scene(4000, 64)
    page = native.Page(library, encode(quantized))
    mean = page.gaussians(camera.centre)["mean"]
    row = np.append(camera.rotation[2], camera.translation[2] - 3.9).astype(np.float32)
    depth = (mean[:, 0] * row[0] + mean[:, 1] * row[1]) + mean[:, 2] * row[2] + row[3]
    order = page.order(row)
    assert set(order) == set(np.flatnonzero(depth > np.float32(0.2)))
    assert (np.diff(depth[order]) <= 0).all()


def test_damaged_files_are_refused_in_words(library):
    data = encode(random_scene(np.random.default_rng(2), 300))
    with pytest.raises(ValueError, match=r"no \.clgs file"):
        native.Page(library, b"PK" + data)
    rng = np.random.default_rng(3)
    for at in rng.integers(16, len(data), 200).tolist():
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(rng.integers(8))
        with pytest.raises(ValueError, match="copy"):
            native.Page(library, bytes(damaged))
    for size in rng.integers(0, len(data), 100).tolist():
        with pytest.raises(ValueError, match=r"copy|no \.clgs file"):
            native.Page(library, data[:size])


def test_it_has_the_constants_of_the_method():
    text = "".join(path.read_text() for path in (native.ROOT / "web/wasm").glob("*.h"))
    numbers = dict(re.findall(r"\b([A-Z_]+) = (\d+)", text))
    names = {"OFFSETS": "K_OFFSETS", "FEATURES": "FEATURE_DIM", "HIDDEN": "HIDDEN_DIM"}
    for own, name in names.items():
        assert int(numbers[own]) == getattr(constants, name)
    limit = re.search(r"LOG_SCALE_LIMIT ([\d.]+)f", text)
    assert float(limit[1]) == constants.LOG_SCALE_LIMIT
