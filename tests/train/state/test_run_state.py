"""The state of a run: the order of its views, and what a checkpoint brings back."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from clgs.lab.scenes import anchor_scene
from clgs.ops.rate import forward
from clgs.scene.anchors import QuantizationScales
from clgs.train.config import TrainConfig
from clgs.train.quality.importance import Sensitivity
from clgs.train.state.checkpoint import load_state, save_state
from clgs.train.state.run_state import ANCHOR_GROUPS, RateTables, ViewOrder, new_state

DIGEST = "d" * 64


@pytest.mark.parametrize("exposure", [False, True])
@pytest.mark.parametrize("late", [False, True])
def test_a_checkpoint_brings_everything_back(device, tmp_path, exposure, late):
    """Before a first round nothing is known of the anchors, and there are no tables."""
    config = replace(TrainConfig(), exposure=exposure).for_dataset("photos")
    scene, _ = anchor_scene(300, 16)
    rng = np.random.default_rng(9)
    rng.integers(0, 7, 3, dtype=np.int32)  # leaves half a 64-bit draw in the state
    state = new_state(device, config, 7, scene.anchors, scene.mlps, rng)
    state.step, state.merged = 4, 2
    state.views.take(4)
    if late:
        anchors, count = state.parameters.scene.anchors, len(scene.anchors)
        scales = QuantizationScales(300.0, 2.0, 4.0, 16.0)
        state.rate.scales, state.rate.price = scales, 1e-7
        rates = {n: forward(device, getattr(anchors, n), getattr(scales, n)) for n in ANCHOR_GROUPS}
        state.rate.tables = [RateTables(step, rates, count) for step in (2, 4)]
        curvature = {n: np.square(getattr(scene.anchors, n)) for n in ANCHOR_GROUPS}
        seen = rng.random(count) < 0.5
        state.known = Sensitivity(rng.random(count, np.float32), curvature, seen)
    save_state(tmp_path, device, state, DIGEST)
    found = load_state(tmp_path, device, DIGEST)
    assert arrays_of(device, found) == arrays_of(device, state)
    assert (found.step, found.merged) == (4, 2)
    assert found.rng.bit_generator.state == state.rng.bit_generator.state
    mine, theirs = (one.rng.integers(0, 1 << 20, 9, dtype=np.int32) for one in (state, found))
    assert mine.tolist() == theirs.tolist()
    assert [found.views.take(1)[0] for _ in range(9)] == [state.views.take(1)[0] for _ in range(9)]
    assert (found.rate.scales, found.rate.price) == (state.rate.scales, state.rate.price)
    assert (found.exposures is None, found.known is None) == (not exposure, not late)
    assert len(found.rate.tables) == int(late)  # older ones serve steps that are done again
    for one, other in zip(found.rate.tables, state.rate.tables[-1:], strict=True):
        assert (one.step, one.anchors, one.bits) == (other.step, other.anchors, other.bits)
        for name in ANCHOR_GROUPS:
            assert one.rates[name].q == other.rates[name].q
            np.testing.assert_array_equal(one.rates[name].table, other.rates[name].table)


def arrays_of(device, state):
    parameters = state.parameters
    arrays = dict(parameters.scene.items()) | dict(parameters.statistics.items())
    records = dict(parameters.moments)
    if state.exposures is not None:
        arrays["maps"], records["maps"] = state.exposures.maps, state.exposures.moments
    for name, moments in records.items():
        arrays |= {f"{which} {name}": array for which, array in moments.items()}
    host = {name: device.download(array) for name, array in arrays.items()}
    if state.known is not None:
        host |= {"importance": state.known.importance, "seen": state.known.seen}
        host |= {f"curvature {name}": array for name, array in state.known.curvature.items()}
    return {name: (array.shape, array.tobytes()) for name, array in host.items()}


def test_every_view_once_an_epoch_in_changing_order():
    views = ViewOrder(20, 3)
    epochs = [[views.take(1)[0] for _ in range(20)] for _ in range(5)]
    for epoch in epochs:
        assert Counter(epoch) == Counter(range(20))
    assert len({tuple(epoch) for epoch in epochs}) == 5


@pytest.mark.parametrize("batch", [1, 2, 3, 7, 20])
def test_a_batch_has_no_view_twice_and_an_epoch_has_all(batch):
    views, single = ViewOrder(20, 3), ViewOrder(20, 3)
    batches = [views.take(batch) for _ in range(60)]
    assert all(len(set(one)) == batch for one in batches)
    dealt = [view for one in batches for view in one]
    for first in range(0, len(dealt) - 19, 20):
        assert Counter(dealt[first : first + 20]) == Counter(range(20))
    if 20 % batch == 0:  # epochs end with a batch: the order is that of single views
        assert dealt == [single.take(1)[0] for _ in dealt]
    with pytest.raises(ValueError, match="21 different views of 20"):
        views.take(21)


def test_order_depends_on_the_seed_alone():
    def deal(seed: int) -> list[int]:
        views = ViewOrder(30, seed)
        return [views.take(1)[0] for _ in range(60)]

    assert deal(1) == deal(1)
    assert deal(1) != deal(2)


@pytest.mark.parametrize("taken", [0, 1, 6, 7, 8, 20])
def test_restored_views_continues_exactly(taken):
    views = ViewOrder(7, 5)
    for _ in range(taken):
        views.take(1)
    restored = ViewOrder.restore(json.loads(json.dumps(views.record())))
    assert [restored.take(1)[0] for _ in range(30)] == [views.take(1)[0] for _ in range(30)]


def test_state_is_a_copy():
    views = ViewOrder(4, 0)
    views.take(1)
    state = views.record()
    before = json.dumps(state)
    for _ in range(9):
        views.take(1)
    assert json.dumps(state) == before


def test_no_views_is_an_error():
    with pytest.raises(ValueError, match="no view"):
        ViewOrder(0, 0)
