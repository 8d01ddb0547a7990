"""The three parts of a run in blocks share the steps, the rates and the growth of one run."""

from __future__ import annotations

from dataclasses import replace

import pytest

from clgs.cluster.block_task import (
    block_config,
    check_settings,
    coarse_config,
    joint_begin,
    joint_config,
)
from clgs.errors import UsageError
from clgs.train.config import preset
from clgs.train.step.schedule import learning_rates

WHOLE = preset("default").for_dataset("colmap")
LEFT = "-inf,-inf,-inf,0.5,inf,inf"


@pytest.mark.parametrize("steps", [10, 11, 60, 1000, 30_000])
@pytest.mark.parametrize("share", [0.01, 0.3, 1.0])
def test_the_parts_follow_each_other(steps, share):
    whole = preset("default").scaled(steps).for_dataset("colmap")
    coarse = coarse_config(whole, 1000)
    block, begun = block_config(whole, share, LEFT)
    joint = joint_config(whole)
    assert coarse.steps == round(0.25 * steps)
    assert begun == round(share * 0.25 * steps) < block.steps
    assert joint_begin(whole) <= joint.switch_step < joint.freeze_step <= joint.steps == steps
    if share == 1.0:
        assert (begun, block.steps) == (coarse.steps, joint_begin(whole))
    for part in (coarse, block):
        assert part.switch_step == part.steps - 1
    assert coarse.size_lambda == 0.0
    assert block.size_lambda == joint.size_lambda == whole.size_lambda


def test_a_block_learns_as_fast_as_the_whole_at_the_same_share_of_the_steps():
    block, begun = block_config(WHOLE, 0.25, LEFT)
    assert begun == 1875
    assert block.steps == 3000  # the others are done by the merged scene
    for step in (1875, 2500, 3000):
        assert learning_rates(block, step, 1.0) == learning_rates(WHOLE, 4 * step, 1.0)
    assert block.growth_interval == 25  # its anchors are seen four times as often
    assert block.growth_end == 2999


def test_the_coarse_scene_has_half_the_size_of_the_photos():
    assert coarse_config(WHOLE, 1001).max_size == 500
    assert coarse_config(replace(WHOLE, downscale=3), 800).downscale == 6


def test_small_photos_of_the_coarse_scene_keep_their_size():
    assert coarse_config(WHOLE, 700).max_size == 400
    assert coarse_config(WHOLE, 160).max_size == 160
    assert coarse_config(replace(WHOLE, downscale=3), 799).downscale == 3


@pytest.mark.parametrize("switch", [0, 200, 900, 1000])
def test_an_early_or_late_switch_leaves_steps_to_each_part(switch):
    config = replace(WHOLE.scaled(1000), growth_start=0, growth_end=0, statistics_start=0)
    config = replace(config, switch_step=switch, freeze_step=1000)
    coarse, block = coarse_config(config, 1000), block_config(config, 1.0, LEFT)[0]
    joint = joint_config(config)
    assert coarse.steps < block.steps == joint_begin(config) <= joint.switch_step < 1000


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"steps": 9}, "steps: 9 are too few"),
        ({"box": LEFT}, "--box"),
        ({"exposure": True}, "--exposure"),
        ({"adam": "visible"}, "--adam visible"),
    ],
)
def test_settings_that_do_not_go_with_blocks_are_named(change, named):
    whole = preset("default").scaled(change.pop("steps", 60))
    with pytest.raises(UsageError, match=f"^{named}"):
        check_settings(replace(whole, **change))
