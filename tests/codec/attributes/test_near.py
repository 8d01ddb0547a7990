"""Near rows, and predictions that look at them."""

from __future__ import annotations

import numpy as np
import pytest

from clgs import _codec
from clgs.codec import row_coder
from clgs.codec.attribute_model import NEAR_COUNT, NearRows, empty_model, find_near
from clgs.codec.octree import morton_order
from clgs.codec.scene_decoder import decode
from clgs.codec.scene_encoder import encode, sort_anchors
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.scene import QuantizedScene
from codec_c.reader.attributes import Attributes, near_rows
from codec_c.reader.files import read_file
from tests.codec.scenes import assert_same

CLOUDS = {
    "none": np.empty((0, 3), np.int32),
    "one": np.array([[-(2**31), 2**31 - 1, 0]]),
    "cube": np.argwhere(np.ones((6, 6, 6), bool)),
    "far apart": np.random.default_rng(1).integers(-(2**20), 2**20, (300, 3)),
    "a line": np.arange(200)[:, None] * [[5, 0, 1]],
}


@pytest.mark.parametrize("name", CLOUDS)
def test_near_rows_are_those_of_the_document(name: str) -> None:
    position = CLOUDS[name].astype(np.int32)
    position = position[morton_order(position)] if len(position) else position
    found = [[k for k in rows if k >= 0] for rows in find_near(position).tolist()]
    assert found == near_rows(position.tolist())


def test_positions_that_span_too_much_are_refused() -> None:
    with pytest.raises(ValueError, match="out of range"):
        find_near(np.array([[0, 0, 0], [2**21, 0, 0]], np.int32))


def test_near_rows_of_another_number_are_refused() -> None:
    table = empty_model(1)
    near = np.zeros((8, NEAR_COUNT), np.int32)
    with pytest.raises(ValueError, match="not as many as the rows"):
        _codec.attributes_encode(table, np.zeros((9, 1), np.int32), near)


def smooth_scene(side: int) -> QuantizedScene:
    """Features that change slowly over a bent sheet, and noise; rows in random order."""
    rng = np.random.default_rng(3)
    u, v = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    sheet = np.stack([3 * u, 3 * v, (u - v) ** 2 // side], -1).reshape(-1, 3)
    position = rng.permutation(sheet).astype(np.int32)
    count = len(position)
    wave = np.sin(position @ rng.normal(0, 0.05, (3, 50)))
    anchors = QuantizedAnchors(
        position,
        np.rint(rng.laplace(0, 0.5, (count, 10, 3))).astype(np.int32),
        np.rint(6 * wave + rng.normal(0, 1, (count, 50))).astype(np.int32),
        np.rint(rng.normal(-30, 3, (count, 6))).astype(np.int32),
    )
    return QuantizedScene(anchors, Mlps(np.zeros(MLP_SIZE, np.float32)))


def test_a_smooth_scene_takes_less_with_positions() -> None:
    anchors = sort_anchors(smooth_scene(60).anchors)
    near = NearRows(anchors.position, [slice(0, len(anchors))])
    model = row_coder.fit(anchors.feature, "default", near=near)
    assert model.looks_near
    size = len(model.encode(anchors.feature, near.of(0)))
    plain = row_coder.fit(anchors.feature, "default")
    assert size < 0.97 * len(plain.encode(anchors.feature))


@pytest.mark.parametrize("level", ["default", "max"])
def test_both_decoders_read_near_rows(level: str) -> None:
    anchors = sort_anchors(smooth_scene(14).anchors)
    rows = np.ascontiguousarray(anchors.feature[:, :6])
    near = NearRows(anchors.position, [slice(0, len(rows))])
    model = row_coder.fit(rows, level, near=near)
    assert model.looks_near
    chunk = model.encode(rows, near.of(0))
    np.testing.assert_array_equal(model.decode(chunk, len(rows), near.of(0)), rows)
    reader, plain = Attributes(model.header, 6), near_rows(anchors.position.tolist())
    np.testing.assert_array_equal(reader.decode(chunk, len(rows), plain), rows)


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [16, 65536])
def test_a_smooth_scene_is_read_by_the_document(chunk: int) -> None:
    scene = smooth_scene(16)
    data = encode(scene, chunk=chunk)
    assert data == encode(scene, chunk=chunk, threads=1)
    scene.anchors = sort_anchors(scene.anchors)
    assert_same(decode(data), scene)
    found = read_file(data)
    np.testing.assert_array_equal(found.attributes["FEAT"], scene.anchors.feature)
