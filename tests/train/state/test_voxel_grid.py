from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from clgs.errors import DataError
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors, dequantize
from clgs.train.state.voxel_grid import initial_anchors, voxel_integers

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], np.float32)


def test_scaling_by_hand():
    anchors = initial_anchors(CORNERS, 0.5)
    assert anchors.position.tolist() == sorted(CORNERS.tolist())
    # squared distances from the origin: 1, 4, 9; from (1, 0, 0): 1, 5, 10; and so on
    mean = {(0, 0, 0): 14 / 3, (1, 0, 0): 16 / 3, (0, 2, 0): 22 / 3, (0, 0, 3): 32 / 3}
    for position, scaling in zip(anchors.position, anchors.scaling, strict=True):
        expected = 0.5 * np.log(mean[tuple(position)])
        np.testing.assert_allclose(scaling, expected, rtol=1e-6)
    assert not anchors.offset.any()
    assert not anchors.feature.any()


@settings(max_examples=30, deadline=None)
@given(
    hnp.arrays(np.float32, (40, 3), elements=st.floats(-3, 3, width=32)),
    st.sampled_from([0.001, 0.005, 0.3, 1.0]),
)
def test_against_brute_force(points, voxel):
    rows = {tuple(np.rint(p * np.float64(1 / voxel)).astype(int)) for p in points.astype(float)}
    if len(rows) < 4:
        with pytest.raises(DataError, match="at least 4"):
            initial_anchors(points, voxel)
        return
    anchors = initial_anchors(points, voxel)
    integers = np.array(sorted(rows))
    np.testing.assert_array_equal(np.rint(anchors.position / voxel), integers)
    position = anchors.position.astype(np.float64)
    squared = np.sum((position[:, None] - position[None]) ** 2, axis=2)
    nearest = np.sort(squared, axis=1)[:, 1:4].mean(axis=1)
    expected = 0.5 * np.log(np.maximum(nearest, 1e-7))
    np.testing.assert_allclose(anchors.scaling, np.repeat(expected[:, None], 6, 1), atol=1e-5)


def test_positions_are_the_dequantised_integers():
    points = np.random.default_rng(1).uniform(-2.0, 2.0, (500, 3)).astype(np.float32)
    for voxel in (0.001, 0.005, 0.003):
        anchors = initial_anchors(points, voxel)
        integers = voxel_integers(points, voxel).astype(np.int32)
        assert len(anchors) == len(integers)
        quantized = QuantizedAnchors(
            integers,
            np.zeros(anchors.offset.shape, np.int32),
            np.zeros(anchors.feature.shape, np.int32),
            np.zeros(anchors.scaling.shape, np.int32),
        )
        expected = dequantize(quantized, QuantizationScales(position=1.0 / voxel))
        np.testing.assert_array_equal(anchors.position, expected.position)


def test_duplicates_and_order_do_not_matter():
    rng = np.random.default_rng(2)
    points = rng.uniform(-1.0, 1.0, (200, 3)).astype(np.float32)
    twice = rng.permutation(np.concatenate([points, points + np.float32(1e-5)]))
    first, second = initial_anchors(points, 0.05), initial_anchors(twice.astype(np.float64), 0.05)
    np.testing.assert_array_equal(first.position, second.position)
    np.testing.assert_array_equal(first.scaling, second.scaling)


def test_squared_distance_is_floored():
    anchors = initial_anchors(CORNERS * np.float32(1e-5), 1e-5)
    np.testing.assert_allclose(anchors.scaling, 0.5 * np.log(1e-7), rtol=1e-6)


@pytest.mark.parametrize(
    ("points", "voxel", "message"),
    [
        (CORNERS[:3], 0.1, "at least 4"),
        (np.repeat(CORNERS[:2], 50, axis=0), 0.1, "100 points in 2 voxels"),
        (np.zeros((0, 3), np.float32), 0.1, "0 points"),
        (np.where(CORNERS == 2, np.nan, CORNERS), 0.1, "not finite"),
        (np.where(CORNERS == 3, np.inf, CORNERS), 0.1, "not finite"),
        (CORNERS * 700_000, 1.0, "extent is 2100000 voxels"),
        (CORNERS + np.float32(2.2e6), 1.0, "from the origin"),
    ],
)
def test_bad_points_are_refused(points, voxel, message):
    with pytest.raises(DataError, match=message) as caught:
        initial_anchors(points, voxel)
    assert "\n" not in str(caught.value)


def test_the_largest_extent_is_exact():
    points = np.array([[0, 0, 0], [2**21 - 1, 1, 0], [5, 0, 0], [0, 7, 0]], np.float32)
    anchors = initial_anchors(points * np.float32(0.25), 0.25)
    assert sorted((anchors.position * 4).tolist()) == sorted(points.tolist())
    points[1, 0] += 1
    with pytest.raises(DataError, match="extent"):
        initial_anchors(points * np.float32(0.25), 0.25)
