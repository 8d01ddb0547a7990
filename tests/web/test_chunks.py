"""Chunks of a file in layers that come in any order: what is drawn meanwhile, and in the end."""

import ctypes

import numpy as np
import pytest

from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode
from tests.web import native
from tests.web.scenes import quantized_scene
from tests.web.test_details import assert_drawn

pytestmark = native.NEEDS

BEGIN, END, LAYER = 0, 1, 2


def first_layer(library, data):
    """The page with the first layer of ``data``, and where later chunks lie; zeros are there."""
    front = describe(data)["layers"][0]["end"]
    page = native.Page(library, data[:front] + bytes(len(data) - front), front)
    assert page.layers[1] == 1
    chunks = page.chunks
    later = np.flatnonzero(chunks[:, LAYER] > 0)
    return page, [(int(i), *chunks[i, [BEGIN, END]].astype(int).tolist()) for i in later]


def items(page):
    return int(page.array("numbers", ctypes.c_double, 1)[0])


@pytest.mark.parametrize("details", [False, True])
def test_chunks_may_come_in_any_order(library, rng, details):
    scene, camera = quantized_scene(4000, 64)
    data = encode(scene, chunk=64, layers=4, details=details)
    page, later = first_layer(library, data)
    counts = [len(page.gaussians(camera.centre)["mean"])]
    for at in rng.permutation(len(later)):
        index, begin, end = later[at]
        page.take(index, begin, data[begin:end])
        counts.append(len(page.gaussians(camera.centre)["mean"]))
    assert counts == sorted(counts)
    assert counts[-1] > 2 * counts[0]
    assert items(page) == len(scene.anchors)
    assert page.layers == (4, 3 if details else 4)
    rest = max(end for _, _, end in later)
    assert (rest < len(data)) == details
    page.fill(rest, data[rest:])
    page.arrive(len(data))
    assert page.layers == (4, 4)
    assert_drawn(library, page, decode(data))


def test_layers_are_ready_once_all_chunks_before_them_have_come(library):
    data = encode(quantized_scene(3000, 64)[0], chunk=64, layers=3)
    page, later = first_layer(library, data)
    of = [int(page.chunks[index, LAYER]) for index, _, _ in later]
    for index, begin, end in later[::-1]:
        page.take(index, begin, data[begin:end])
        missing = of[: later.index((index, begin, end))]
        assert page.layers == (3, min(missing, default=3))


def test_bounds_are_those_of_the_anchors(library):
    scene, _ = quantized_scene(3000, 64)
    data = encode(scene, chunk=64, layers=3)
    page = native.Page(library, data)
    position = page.array("positions", ctypes.c_float, 3 * len(scene.anchors)).reshape(-1, 3)
    least, greatest = page.chunks[:, 3:6], page.chunks[:, 6:]
    assert len(least) == describe(data)["chunks"]["count"]
    near = position[:, None] + 1e-6 >= least, position[:, None] - 1e-6 <= greatest
    inside = np.all(near[0] & near[1], axis=2)
    assert inside.any(axis=1).all()
    assert inside.sum(axis=0).min() >= 1
    np.testing.assert_allclose(least.min(axis=0), position.min(axis=0), rtol=1e-6)
    np.testing.assert_allclose(greatest.max(axis=0), position.max(axis=0), rtol=1e-6)
    assert np.median(np.prod(greatest - least, axis=1)) < np.prod(np.ptp(position, axis=0)) / 8


def test_damaged_chunks_and_those_that_are_there_are_refused(library):
    data = encode(quantized_scene(2000, 64)[0], chunk=64, layers=3)
    for part in (0, -1):
        page, later = first_layer(library, data)
        index, begin, end = later[1]
        bad = bytearray(data[begin:end])
        bad[part] ^= 4
        with pytest.raises(ValueError, match="damaged; copy the file again"):
            page.take(index, begin, bytes(bad))
    for wrong in ("twice", "first", "none"):
        page, later = first_layer(library, data)
        index, begin, end = later[0]
        page.take(index, begin, data[begin:end])
        number = {"twice": index, "first": 0, "none": len(page.chunks)}[wrong]
        with pytest.raises(ValueError, match="asked for twice"):
            page.take(number, begin, data[begin:end])
