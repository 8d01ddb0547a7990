"""Growing of anchors against cases computed by hand and against plain loops."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clgs.constants import K_OFFSETS
from clgs.errors import ClgsError
from clgs.train.config import TrainConfig
from clgs.train.state.run_state import HostRows
from clgs.train.step.grow_and_prune import threshold
from tests.train.step.density_cases import (
    CONFIG,
    VOXEL,
    Draws,
    ask,
    assert_rows,
    grow,
    integers_of,
    random_state,
    state_at,
)


def test_a_new_anchor_by_hand(device):
    state = state_at([(0, 0, 0), (100, 0, 0)])
    ask(state, 0, 3, (8.9, -6.5, 1.9), 0.3)
    assert grow(device, state, CONFIG, Draws()) == 1
    # cells of 4 voxels: 8.9 -> 2, -6.5 -> -2 (-1.6 rounded), 1.9 -> 0
    assert integers_of(state)[2] == (8, -8, 0)
    np.testing.assert_array_equal(state.anchors.scaling[2], np.float32(np.log(4 * VOXEL)))
    np.testing.assert_array_equal(state.anchors.feature[2], 1)
    assert not state.anchors.offset[2].any()
    assert_rows(state, [1, 2, 0])
    assert (state.statistics.opacity_sum.tolist(), state.statistics.visits[2]) == ([1, 2, 0], 0)


def test_slot_position_scales_with_exp_of_scaling(device):
    state = state_at([(11, 0, 0)])
    ask(state, 0, 0, (4.0, 4.0, 4.0), 0.3)
    state.anchors.scaling[0] = [np.log(2), np.log(3), 0, 7, 7, 7]
    grow(device, state, CONFIG, Draws())
    assert integers_of(state)[1] == (20, 12, 4)  # cell 5 of 4 voxels is nearest to 11 + 2 * 4


def test_levels_have_cells_of_4_and_1_voxels_and_doubled_thresholds(device):
    state = state_at([(0, 0, 0)])
    ask(state, 0, 0, (9.0, 0, 0), 0.25)  # asks at level 0 only
    ask(state, 0, 1, (21.0, 0, 0), 0.5)  # at levels 0 and 1
    ask(state, 0, 2, (33.0, 0, 0), np.nextafter(np.float32(0.5), np.float32(0)))
    ask(state, 0, 3, (50.0, 0, 0), np.nextafter(np.float32(0.25), np.float32(0)))
    draws = Draws()
    assert grow(device, state, CONFIG, draws) == 4
    assert integers_of(state)[1:] == [(8, 0, 0), (20, 0, 0), (32, 0, 0), (21, 0, 0)]
    assert draws.sizes == [3, 1]  # level 2 would have cells of 4 // 16 = 0 voxels
    np.testing.assert_array_equal(
        state.anchors.scaling[1:, 0], np.log([2.0, 2.0, 2.0, 0.5]).astype(np.float32)
    )


def test_without_room_for_all_the_slots_of_the_largest_gradient_grow(device):
    state = state_at([(0, 0, 0), (100, 0, 0)])
    ask(state, 0, 0, (12.0, 0, 0), 0.3)
    ask(state, 1, 9, (8.0, 0, 0), 0.4)
    ask(state, 1, 4, (40.0, 0, 0), 0.35)
    assert grow(device, state, replace(CONFIG, max_anchors=4), Draws()) == 2
    assert integers_of(state)[2:] == [(108, 0, 0), (140, 0, 0)]
    assert grow(device, state, replace(CONFIG, max_anchors=4), Draws()) == 0


def test_as_many_slots_ask_as_the_size_has_room_for():
    config = TrainConfig(target_size=100_000).for_dataset("blender")
    held = config.held_anchors
    mean = np.random.default_rng(0).uniform(0, 3e-4, 1000)
    for missing, asking in ((400, 400), (600, 600), (1, (mean >= 2e-4).sum())):
        least = threshold(config, held - missing, mean)
        assert 1e-4 <= least <= 2e-4
        assert (mean >= least).sum() == asking
    assert threshold(config, held, mean) == threshold(config, 2 * held, mean) == 2e-4
    assert threshold(config, 0, mean) == threshold(config, held - 800, mean) == 1e-4
    assert threshold(replace(config, growth_threshold=1e-3), 0, mean) == 1e-3
    assert threshold(replace(config, growth_threshold=0.0), 0, mean) == 0.0
    few = replace(config, max_anchors=300)
    assert (mean >= threshold(few, 100, mean)).sum() == max(200, (mean >= 2e-4).sum())
    assert threshold(few, 300, mean) == 2e-4
    assert threshold(config, 0, mean[:0]) == 2e-4


def test_slots_with_small_gradients_fill_a_size(device):
    state = state_at([(0, 0, 0), (100, 0, 0)])
    ask(state, 0, 0, (12.0, 0, 0), 1.2e-4)
    ask(state, 1, 9, (8.0, 0, 0), 0.4e-4)
    ask(state, 1, 4, (40.0, 0, 0), 2.5e-4)
    before = copy.deepcopy(state)
    config = TrainConfig(voxel=VOXEL)
    assert grow(device, before, config, Draws()) == 1
    assert grow(device, state, replace(config, target_size=100_000), Draws()) == 2
    assert integers_of(state)[2:] == [(12, 0, 0), (140, 0, 0)]


def test_large_scenes_may_use_three_levels(device):
    state = state_at([(0, 0, 0)])
    ask(state, 0, 0, (37.0, 0, 0), 1.0)
    config = TrainConfig(voxel=VOXEL, growth_threshold=0.25, growth_cell=16)
    assert grow(device, state, config, Draws()) == 3
    assert integers_of(state)[1:] == [(32, 0, 0), (36, 0, 0), (37, 0, 0)]


def test_a_cell_that_holds_an_anchor_is_not_new(device):
    state = state_at([(0, 0, 0), (9, 0, 0)])
    ask(state, 0, 0, (8.0, 0, 0), 0.3)  # cell 2, where voxel 9 lies too
    assert grow(device, state, CONFIG, Draws()) == 0
    assert_rows(state, [1, 2])


def test_deeper_levels_wait_for_level_0(device):
    state = state_at([(0, 0, 0)])
    ask(state, 0, 0, (1.0, 0, 0), 9.0)  # its own cell at level 0, a free voxel at level 1
    draws = Draws()
    assert grow(device, state, CONFIG, draws) == 0
    assert draws.sizes == [1]
    ask(state, 0, 0, (1.0, 0, 0), 9.0)
    ask(state, 0, 1, (8.0, 0, 0), 0.3)
    assert grow(device, state, CONFIG, Draws()) == 2
    assert integers_of(state)[1:] == [(8, 0, 0), (1, 0, 0)]


def test_an_anchor_of_level_0_occupies_its_voxel_at_level_1(device):
    state = state_at([(0, 0, 0)])
    ask(state, 0, 0, (8.0, 0, 0), 9.0)
    assert grow(device, state, CONFIG, Draws()) == 1


def test_offset_zero_stays_in_the_anchors_own_cell(device):
    """Also halfway between two cells, where float32 positions would round either way."""
    config = TrainConfig(voxel=0.005, growth_threshold=0.25)
    state = state_at([(4 * i + 2, -4 * i - 2, 6 * i) for i in range(50)])
    state.anchors.position[:] *= np.float32(0.005 / VOXEL)
    state.statistics.gradient_count[:] = 64
    state.statistics.gradient_sum[:] = 64.0
    assert grow(device, state, config, Draws()) == 0


def test_kept_with_probability_1_minus_half_to_the_level_plus_1(device):
    state = state_at([(0, 0, 0)])
    for slot in range(4):
        ask(state, 0, slot, (8.0 + 8 * slot + 1, 0, 0), 1.0)
    above = np.nextafter([0.5, 0.25], 1)
    draws = Draws([0.0, 0.5, above[0], 1.0], [0.0, 0.25, above[1], 1.0])
    assert grow(device, state, CONFIG, draws) == 4
    assert integers_of(state)[1:] == [(24, 0, 0), (32, 0, 0), (25, 0, 0), (33, 0, 0)]


def test_feature_is_the_maximum_over_the_anchors_that_asked(device):
    state = state_at([(0, 0, 0), (20, 0, 0), (0, 20, 0), (20, 20, 0)])
    feature = state.anchors.feature
    feature[:] = np.random.default_rng(0).normal(-3, 1, feature.shape)
    ask(state, 0, 5, (12, 12, 0), 0.3)
    ask(state, 0, 6, (13, 12, 0), 0.3)
    ask(state, 1, 2, (-8, 13, 1), 0.3)
    ask(state, 2, 9, (12, -8, 0), 0.2)  # below the threshold
    ask(state, 3, 0, (-8, -8, 0), 0.3)  # its draw fails
    assert grow(device, state, CONFIG, Draws([0.9, 0.9, 0.9, 0.1])) == 1
    expected = np.maximum(feature[0], feature[1])
    np.testing.assert_array_equal(state.anchors.feature[4], expected)


def test_slots_seen_often_start_anew_and_others_accumulate(device):
    state = state_at([(0, 0, 0), (40, 0, 0)])
    statistics = state.statistics
    statistics.gradient_count[0, :3] = [40, 41, 500]
    statistics.gradient_sum[0, :3] = [30.0, 1.0, 400.0]
    state.anchors.offset[0, :3, 1] = [20, 40, 60]
    assert grow(device, state, CONFIG, Draws()) > 0  # slot 0 is strong but seen too rarely; 2 grows
    assert (0, 40, 0) not in integers_of(state)
    assert state.statistics.gradient_count[0, :3].tolist() == [40, 0, 0]
    assert state.statistics.gradient_sum[0, :3].tolist() == [30.0, 0.0, 0.0]
    assert state.statistics.opacity_sum[:2].tolist() == [1.0, 2.0]
    assert not state.statistics.gradient_count[2:].any()


@pytest.mark.parametrize("voxels", [np.nan, np.inf, 2.0**21, -(2.0**21), 1e30])
def test_slots_beyond_the_grid_are_not_served(device, voxels):
    state = state_at([(0, 0, 0), (5, 0, 0)])
    ask(state, 0, 0, (voxels, 0, 0), 9.0)
    ask(state, 0, 1, (16, 0, 0), 0.3)
    assert grow(device, state, CONFIG, Draws()) == 1
    assert integers_of(state)[2] == (16, 0, 0)


def test_growth_never_makes_the_scene_too_large(device):
    half = 2**20
    state = state_at([(0, 0, 0), (half, 0, 0)])
    ask(state, 0, 0, (-(half // 2) + 4, 0, 0), 9.0)
    ask(state, 1, 0, (half // 2 - 4, 0, 0), 9.0)
    ask(state, 0, 1, (-half // 2 - 8, 0, 0), 9.0)
    ask(state, 1, 1, (half // 2 + 8, 0, 0), 9.0)
    assert grow(device, state, CONFIG, Draws()) == 2
    rows = np.array(integers_of(state))
    assert np.ptp(rows, axis=0).max() < 2**21
    state = state_at([(0, 0, 0), (2**21, 0, 0)])
    with pytest.raises(ClgsError, match=r"extent is 2097152 grid cells"):
        grow(device, state, CONFIG, Draws())


def brute_grow(state: HostRows, config: TrainConfig, rng: np.random.Generator) -> list[Any]:
    """New (integers, feature, cell) in order, written as the rules read."""
    anchors, statistics = state.anchors, state.statistics
    taken = [np.array(row) for row in integers_of(state)]
    new: list[Any] = []
    for level, factor in enumerate((4, 1)):
        if level and not new:
            break
        asking = [
            (row, slot)
            for row in range(len(anchors))
            for slot in range(K_OFFSETS)
            if statistics.gradient_count[row, slot] > 40
            and statistics.gradient_sum[row, slot] / statistics.gradient_count[row, slot]
            >= np.float32(config.growth_threshold * 2**level)
        ]
        kept = rng.random(len(asking)) > 0.5 ** (level + 1)
        cells: dict[tuple[int, ...], list[int]] = {}
        for (row, slot), keep in zip(asking, kept, strict=True):
            shift = anchors.offset[row, slot] * np.exp(anchors.scaling[row, :3].astype(float))
            cell = np.rint((np.array(integers_of(state)[row]) + shift / VOXEL) / factor)
            if keep and not any((np.rint(t / factor) == cell).all() for t in taken):
                cells.setdefault(tuple(int(c) for c in cell), []).append(row)
        for cell, rows in sorted(cells.items()):
            feature = anchors.feature[rows].max(axis=0)
            new.append((tuple(factor * c for c in cell), feature, factor))
        taken += [np.array(item[0]) for item in new]
    return new


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_growth_agrees_with_plain_loops(device, seed):
    state = random_state(seed)
    expected = brute_grow(state, CONFIG, np.random.default_rng(seed))
    before, old = copy.deepcopy(state), len(state.anchors)
    assert grow(device, state, CONFIG, np.random.default_rng(seed)) == len(expected)
    assert integers_of(state)[old:] == [item[0] for item in expected]
    assert len(set(integers_of(state))) == len(state.anchors)
    for item, feature, scaling in zip(
        expected, state.anchors.feature[old:], state.anchors.scaling[old:], strict=True
    ):
        np.testing.assert_array_equal(feature, item[1])
        np.testing.assert_array_equal(scaling, np.float32(np.log(item[2] * VOXEL)))
    for name in ("position", "offset", "feature", "scaling"):
        np.testing.assert_array_equal(
            getattr(state.anchors, name)[:old], getattr(before.anchors, name)
        )
    assert_rows(state, [*range(1, old + 1), *[0] * len(expected)])
