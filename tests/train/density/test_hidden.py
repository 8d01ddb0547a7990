"""Rows of hidden anchors change nothing, until they are left out."""

from __future__ import annotations

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


def test_leaving_out_nothing_keeps_the_arrays(device: Device) -> None:
    there, _ = on_device(device, random_state(4))
    assert grow_and_prune.compacted(device, there) is there
