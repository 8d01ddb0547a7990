"""Scenes cut to a size: never above it, close below it, the most useful anchors kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.scene_decoder import decode
from clgs.codec.scene_encoder import encode
from clgs.codec.smaller import anchor_bits, coarsen, fit_coarsened, fit_size, hidden_products, take
from clgs.errors import UsageError
from clgs.scene.anchors import QuantizationScales
from clgs.scene.mlps import MLP_SIZE, Mlps, init_mlps
from clgs.scene.scene import QuantizedScene
from tests.codec.scenes import assert_same, random_scene


@pytest.fixture
def scene(rng: np.random.Generator) -> QuantizedScene:
    some = random_scene(rng, 3000)
    return replace(some, mlps=Mlps(np.zeros(MLP_SIZE, np.float32)))


def fast(scene: QuantizedScene) -> bytes:
    return encode(scene, "fast", threads=1)


@pytest.mark.parametrize("share", [0.9, 0.2, 0.07])
def test_a_size_is_met_from_below(
    scene: QuantizedScene, rng: np.random.Generator, share: float
) -> None:
    target = int(share * len(fast(scene)))
    order = rng.permutation(len(scene.anchors))
    found, data = fit_size(scene, order, target, fast)
    assert 0.98 * target <= len(data) <= target
    assert data == fast(found)
    expected = take(scene, order[: len(found.anchors)])
    assert_same(found, expected)
    np.testing.assert_array_equal(decode(data).anchors.position.shape, found.anchors.position.shape)


def test_what_fits_stays_whole(scene: QuantizedScene) -> None:
    data = fast(scene)
    order = np.arange(len(scene.anchors))
    assert fit_size(scene, order, len(data), fast)[1] == data
    found, less = fit_size(scene, order, len(data) - 1, fast)
    assert len(less) < len(data)
    assert len(found.anchors) < len(scene.anchors)


def test_less_than_no_anchors_is_refused(scene: QuantizedScene) -> None:
    order = np.arange(len(scene.anchors))
    least = len(fast(take(scene, order[:0])))
    assert len(fit_size(scene, order, least, fast)[1]) == least
    with pytest.raises(UsageError, match=f"{least:,} bytes remain without anchors"):
        fit_size(scene, order, least - 1, fast)


@pytest.mark.parametrize(("share", "all_fit"), [(0.95, True), (0.8, True), (0.4, False)])
def test_anchors_go_only_if_coarser_integers_do_not_suffice(
    scene: QuantizedScene, rng: np.random.Generator, share: float, all_fit: bool
) -> None:
    target, order = int(share * len(fast(scene))), np.arange(len(scene.anchors))
    limits = {"feature": 0.4}
    products = hidden_products(init_mlps(rng))
    found, data, factors = fit_coarsened(scene, limits, products, order, target, fast)
    assert 0.99 * target <= len(data) <= target
    assert data == fast(found)
    assert_same(found, take(coarsen(scene, factors, products), order[: len(found.anchors)]))
    assert (len(found.anchors) == len(scene.anchors)) == all_fit
    assert (factors == limits) == (not all_fit)


def test_coarser_integers_keep_their_meaning(scene: QuantizedScene) -> None:
    found = coarsen(scene, {"feature": 0.5, "scaling": 0.75})
    assert found.scales == QuantizationScales(200.0, 1.0, 0.5, 6.0)
    before, after = scene.dequantize().anchors, found.dequantize().anchors
    np.testing.assert_array_equal(after.position, before.position)
    np.testing.assert_array_equal(after.offset, before.offset)
    assert np.abs(after.feature - before.feature).max() <= 0.5 / 0.5
    assert np.abs(after.scaling - before.scaling).max() <= 0.5 / 6.0 + 2**-20
    assert decode(fast(found)).scales == found.scales
    assert len(fast(found)) < len(fast(scene))


def test_bits_are_those_of_the_frequencies(scene: QuantizedScene) -> None:
    anchors = take(scene, np.arange(400)).anchors
    feature = anchors.feature.copy()
    feature[::2, 0] += 2**30
    wide = replace(anchors, feature=feature)
    for some in (anchors, wide, take(scene, np.arange(1)).anchors):
        expected = np.full(len(some), 12.0)
        for values in (some.offset, some.feature, some.scaling):
            for channel in values.reshape(len(some), -1).T:
                equal = np.array([(channel == value).sum() for value in channel])
                expected += np.log2(len(some) / equal)
        np.testing.assert_allclose(anchor_bits(some), expected, rtol=1e-12)
    assert anchor_bits(take(scene, np.arange(0)).anchors).shape == (0,)


def test_bits_follow_frequencies(scene: QuantizedScene) -> None:
    bits = anchor_bits(scene.anchors)
    assert bits.shape == (len(scene.anchors),)
    common = take(scene, np.argsort(bits)[:200])
    rare = take(scene, np.argsort(bits)[-200:])
    assert len(fast(common)) < len(fast(rare))
