"""If only the anchors of a box learn, all others and the MLPs keep their bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.errors import UsageError
from clgs.scene.region import Box
from clgs.train.config import preset
from clgs.train.config.settings import parse_box
from clgs.train.run.trainer import Trainer

LEFT = "-inf,-inf,-inf,0.01,inf,inf"


def trainer(device, dataset, **changes):
    growing = {"growth_interval": 10, "slot_seen": 4, "anchor_visits": 4, "growth_end": 60}
    settings = replace(preset("default").scaled(240), voxel=0.02, **growing, **changes)
    return Trainer(device, dataset, settings.for_dataset(dataset.kind))


def rows(one):
    """The numbers of every live anchor by its position; anchors do not move."""
    one.compact()
    anchors = one.parameters.download_anchors(one.device)
    values = [anchors.offset, anchors.feature, anchors.scaling]
    flat = np.concatenate([value.reshape(len(anchors), -1) for value in values], 1)
    return {tuple(p): row for p, row in zip(anchors.position.tolist(), flat, strict=True)}


def weights(one):
    return one.device.download(one.parameters.scene.weights)


@pytest.mark.slow
def test_only_the_anchors_in_the_box_learn_come_and_go(dataset, cpu):
    one = trainer(cpu, dataset, box=LEFT, scaling_cap=-4.0)  # which many exceed
    before, mlps = rows(one), weights(one)
    list(one.steps(40))
    after = rows(one)
    np.testing.assert_array_equal(weights(one), mlps)
    outside = {place for place in before if place[0] >= 0.01}
    assert {place for place in after if place[0] >= 0.01} == outside
    assert all(np.array_equal(before[place], after[place]) for place in outside)
    inside, left = set(before) - outside, set(after) - outside
    assert left - inside  # some came
    assert inside - left  # some went
    changed = [not np.array_equal(before[place], after[place]) for place in inside & left]
    assert np.mean(changed) > 0.5  # those that draw nothing have no gradient
    assert one.economy.steps == [60, 84, 108]  # all before the switch at 120: no integer is priced


def test_a_box_around_everything_moves_anchors_as_without_a_box(dataset, cpu):
    """Only the first step is compared: the MLPs of the run without a box change in it."""
    whole, boxed = trainer(cpu, dataset), trainer(cpu, dataset, box="-inf,-inf,-inf,inf,inf,inf")
    before = rows(whole)
    for one in (whole, boxed):
        one.step()
    moved, moved_in_box = rows(whole), rows(boxed)
    assert moved.keys() == before.keys() == moved_in_box.keys()
    assert any(not np.array_equal(row, before[place]) for place, row in moved.items())
    assert all(np.array_equal(row, moved_in_box[place]) for place, row in moved.items())
    assert not np.array_equal(weights(whole), weights(boxed))


def test_a_box_is_read_as_it_is_written():
    box = Box((-np.inf, 0.1, 1 / 3), (np.inf, 0.1025, 7.0))
    assert parse_box(",".join(map(repr, (*box.lower, *box.upper)))) == box
    inside = box.holds(np.array([[0, 0.1, 0.5], [0, 0.1025, 0.5], [np.nan, 0.1, 0.5]]))
    assert inside.tolist() == [True, False, False]


@pytest.mark.parametrize("text", ["1,2,3", "a,b,c,d,e,f", "0,0,0,1,1,nan", "0,0,0,1,0,1", ",,,,,"])
def test_what_is_no_box_is_refused(text):
    with pytest.raises(UsageError, match="give six numbers"):
        preset("default").__class__(box=text)


def test_rows_with_a_gradient_alone_are_another_way():
    with pytest.raises(UsageError, match="box: goes with adam = dense alone"):
        preset("default").__class__(box=LEFT, adam="visible")
