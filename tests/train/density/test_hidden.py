"""Rows of hidden anchors change nothing, until they are left out."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from clgs.constants import K_OFFSETS
from clgs.opencl.device import Device
from clgs.train.density import grow_and_prune
from tests.train.density.density_cases import (
    CONFIG,
    assert_same,
    grow,
    mask_prune,
    on_device,
    prune,
    random_state,
    take_back,
)

CAPPED = replace(CONFIG, max_anchors=33)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([CONFIG, CAPPED]))
def test_events_with_hidden_rows_end_as_events_without(
    device: Device, seed: int, config: grow_and_prune.TrainConfig
) -> None:
    """Two events of growth: rows are left out after every part of them, or at the end."""
    often, late = random_state(seed), random_state(seed)
    there = on_device(device, late)
    first, second = np.random.default_rng(seed), np.random.default_rng(seed)
    for event in range(2):
        drawn = np.random.default_rng(seed + event)
        opacity = drawn.normal(-0.8, 1, (len(often.anchors), K_OFFSETS)).astype(np.float32)
        rows = np.flatnonzero(there.live).astype(np.int32)
        mask_prune(device, often, np.arange(len(often.anchors), dtype=np.int32), opacity)
        seen = device.upload(rows), device.upload(np.ascontiguousarray(opacity.T))
        there = grow_and_prune.mask_prune(device, there.parameters, there.statistics, *seen)
        added = grow(device, often, config, first)
        assert grow_and_prune.grow(device, there, config, second) == added
        gone = prune(device, often, config)
        assert grow_and_prune.prune(device, there, config) == gone
    assert len(there.position) >= len(often.anchors)
    assert there.settled().count == len(often.anchors)
    take_back(device, late, there)
    assert_same(often, late)
    assert first.bit_generator.state == second.bit_generator.state


def test_leaving_out_nothing_keeps_the_arrays(device: Device) -> None:
    state = random_state(4)
    before = copy.deepcopy(state)
    there = on_device(device, state)
    arrays = there.parameters
    grow_and_prune.compact(device, there)
    assert there.parameters is arrays
    take_back(device, state, there)
    assert_same(state, before)
