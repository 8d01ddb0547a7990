"""Pruning and merging of anchors, and whole steps, by hand and against plain loops."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clgs.constants import K_OFFSETS
from clgs.errors import ClgsError
from clgs.train.state.run_state import HostRows
from clgs.train.state.voxel_grid import position_integers
from clgs.train.step import grow_and_prune
from clgs.train.step.grow_and_prune import merge_cells
from tests.train.step.density_cases import (
    CONFIG,
    VOXEL,
    assert_rows,
    assert_same,
    grow,
    integers_of,
    mask_prune,
    on_device,
    prune,
    random_state,
    state_at,
    take_back,
)


def test_mask_prune_by_hand(device):
    state = state_at([(i, 0, 0) for i in range(5)])
    state.anchors.offset[:] = 1.0
    opacity = np.full((3, K_OFFSETS), -0.5, np.float32)
    opacity[0, 2], opacity[0, 4] = 0.3, 0.0  # anchor 1 draws slot 2 alone
    opacity[2] = 0.1  # anchor 4 draws all
    opacity[1, 3] = np.nan  # anchor 3 draws nothing
    assert mask_prune(device, state, np.array([1, 3, 4], np.int32), opacity) == 1
    assert_rows(state, [1, 2, 3, 5])
    assert integers_of(state) == [(0, 0, 0), (1, 0, 0), (2, 0, 0), (4, 0, 0)]
    drawn = np.ones((4, K_OFFSETS), bool)
    drawn[1] = np.arange(K_OFFSETS) == 2
    np.testing.assert_array_equal(state.anchors.offset, np.repeat(drawn[..., None], 3, axis=2))


def test_mask_prune_without_visible_anchors_changes_nothing(device):
    state = random_state(1)
    before = copy.deepcopy(state)
    assert (
        mask_prune(device, state, np.empty(0, np.int32), np.empty((0, K_OFFSETS), np.float32)) == 0
    )
    assert_same(state, before)


def test_prune_by_hand(device):
    state = state_at([(i, 0, 0) for i in range(6)])
    statistics = state.statistics
    least = np.float32(0.005) * np.float32(100)
    statistics.visits[:] = [80, 81, 100, 100, 100, 0]
    statistics.opacity_sum[:] = [
        *(0.0, 0.0, least, np.nextafter(least, np.float32(0)), np.nan, 0.0),
    ]
    assert prune(device, state, CONFIG) == 3  # 1, 3 and 4; 0 and 5 were not visited often enough
    assert_rows(state, [1, 3, 6])
    assert state.statistics.visits.tolist() == [80, 0, 0]
    assert state.statistics.opacity_sum.tolist() == [0.0, 0.0, 0.0]


def test_prune_keeps_sums_of_rarely_visited_anchors(device):
    state = state_at([(0, 0, 0), (1, 0, 0)])
    state.statistics.visits[:] = [80, 81]
    state.statistics.opacity_sum[:] = [0.25, 9.0]
    state.statistics.gradient_sum[:] = 3.0
    assert prune(device, state, CONFIG) == 0
    assert state.statistics.visits.tolist() == [80, 0]
    assert state.statistics.opacity_sum.tolist() == [0.25, 0.0]
    assert (state.statistics.gradient_sum == 3.0).all()


def test_prune_caps_the_shape_scaling_of_all_anchors(device):
    state = state_at([(0, 0, 0), (1, 0, 0)])
    state.anchors.scaling[0] = [1, 2, 3, 1, 0.05, -4]
    assert prune(device, state, CONFIG) == 0
    np.testing.assert_array_equal(
        state.anchors.scaling[0], np.array([1, 2, 3, 0.05, 0.05, -4], np.float32)
    )


def test_pruning_everything_is_an_error(device):
    state = state_at([(0, 0, 0)])
    with pytest.raises(ClgsError, match="left no anchors"):
        mask_prune(device, state, np.array([0], np.int32), np.zeros((1, K_OFFSETS), np.float32))
    state.statistics.visits[:] = 81
    state.statistics.opacity_sum[:] = 0.0
    with pytest.raises(ClgsError, match="left no anchors"):
        prune(device, state, CONFIG)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_rows_stay_together_through_a_whole_step(device, seed):
    """Every surviving anchor keeps its own values and moments; the step is deterministic."""

    def step() -> HostRows:
        state, rng = random_state(seed), np.random.default_rng(seed)
        number = np.arange(1, len(state.anchors) + 1)
        state.anchors.feature[:, 0] = number
        visible = np.flatnonzero(rng.random(len(number)) < 0.7).astype(np.int32)
        opacity = rng.normal(-0.8, 1, (len(visible), K_OFFSETS)).astype(np.float32)
        mask_prune(device, state, visible, opacity)
        grow(device, state, CONFIG, rng)
        prune(device, state, CONFIG)
        return state

    state = step()
    before = random_state(seed)
    numbers = state.moments["scaling"].first[:, 0].astype(int)
    assert_rows(state, numbers.tolist())
    old = numbers > 0
    assert (np.diff(numbers[old]) > 0).all()
    assert (np.argsort(~old, kind="stable") == np.arange(len(old))).all()  # new rows come last
    np.testing.assert_array_equal(state.anchors.feature[old, 0], numbers[old])
    kept = numbers[old] - 1
    np.testing.assert_array_equal(state.anchors.position[old], before.anchors.position[kept])
    np.testing.assert_array_equal(state.anchors.scaling[old, :3], before.anchors.scaling[kept, :3])
    assert_same(state, step())


def test_merge_by_hand():
    state = state_at([(0, 0, 0), (1, 0, 0), (7, 0, 0), (9, 0, 0), (8, 0, 0), (40, 0, 0)])
    state.statistics.opacity_sum[:] = [0.1, 0.2, 0.5, 0.5, 0.4, 0.0]
    assert merge_cells(state, 0.5) == 3  # cells of 4 voxels; 7, 8 and 9 lie in cell 2
    assert_rows(state, [2, 3, 6])
    assert state.anchors.position[:, 0].tolist() == [0.0, 4.0, 20.0]


def test_a_finer_grid_merges_nothing_and_moves_by_half_a_cell_at_most():
    state = random_state(3)
    state.anchors.position[:] *= np.float32(0.001 / VOXEL)
    before = copy.deepcopy(state)
    assert merge_cells(state, 1024.0) == 0
    moved = np.abs(state.anchors.position - before.anchors.position)
    assert moved.max() <= 0.5 / 1024 * (1 + 1e-5)
    integers = position_integers(state.anchors.position, 1024.0)
    np.testing.assert_array_equal(state.anchors.position, (integers / 1024.0).astype(np.float32))
    before.anchors.position[:] = state.anchors.position
    assert_same(state, before)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.1, 0.256, 0.7]))
def test_merge_agrees_with_plain_loops(seed, q_position):
    state = random_state(seed, count=60, spread=8)
    sums = state.statistics.opacity_sum
    sums[:] = np.round(sums, 1)  # so that ties occur
    cells = np.rint(state.anchors.position.astype(float) * q_position)
    best: dict[tuple[float, ...], int] = {}
    for row, cell in enumerate(map(tuple, cells)):
        if cell not in best or sums[row] > sums[best[cell]]:
            best[cell] = row
    rows, count = sorted(best.values()), len(state.anchors)
    assert merge_cells(state, q_position) == count - len(rows)
    assert_rows(state, [row + 1 for row in rows])
    expected = (cells[rows] / q_position).astype(np.float32)
    np.testing.assert_array_equal(state.anchors.position, expected)


def test_a_grid_too_fine_for_the_extent_is_refused():
    state = state_at([(0, 0, 0), (1000, 0, 0)])
    with pytest.raises(ClgsError, match="smaller Q_P"):
        merge_cells(state, 1e5)


CAPPED = replace(CONFIG, max_anchors=33)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([CONFIG, CAPPED]))
def test_events_with_hidden_rows_end_as_events_without(device, seed, config):
    """Two events of growth: rows are left out after every part of them, or at the end."""
    often, late = random_state(seed), random_state(seed)
    there, position = on_device(device, late)
    first, second = np.random.default_rng(seed), np.random.default_rng(seed)
    for event in range(2):
        drawn = np.random.default_rng(seed + event)
        opacity = drawn.normal(-0.8, 1, (len(often.anchors), K_OFFSETS)).astype(np.float32)
        rows = np.flatnonzero(~np.isnan(position[:, 0])).astype(np.int32)
        mask_prune(device, often, np.arange(len(often.anchors), dtype=np.int32), opacity)
        seen = device.upload(rows), device.upload(np.ascontiguousarray(opacity.T))
        position = grow_and_prune.mask_prune(device, there, *seen)
        added, before = grow(device, often, config, first), len(position)
        there, position = grow_and_prune.grow(device, config, there, position, second)
        assert len(position) - before == added
        gone = prune(device, often, config)
        assert grow_and_prune.prune(device, config, there, position) == gone
    assert len(position) >= len(often.anchors)
    assert len(position) - grow_and_prune.count_hidden(position) == len(often.anchors)
    take_back(device, late, there, position)
    assert_same(often, late)
    assert first.bit_generator.state == second.bit_generator.state


def test_leaving_out_nothing_keeps_the_arrays(device):
    there, _ = on_device(device, random_state(4))
    assert grow_and_prune.compacted(device, there) is there
