"""Which cameras a block has, how many blocks fit a worker, and the scene that blocks make again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.cluster.block_plan import Cuts, Pictures, Plan, counts_for_memory, cut_scene, read_plan
from clgs.cluster.block_run import merged_scene
from clgs.codec.scene_encoder import sort_anchors
from clgs.errors import DataError, UsageError
from clgs.scene.anchors import take
from clgs.scene.scene import QuantizationScales
from clgs.scene.storage import save_scene
from tests.codec.scenes import random_scene

UP = np.array([0.0, 0.0, 1.0])
CUTS = Cuts((0, 1), (0.5,), ((), ()), (2.0, 2.0))


def pictures(*seen, trained=None):
    """Pictures of 100 pixels; each of ``seen`` is {anchor: weight}."""
    found = [(np.array(list(one), np.intp), np.array(list(one.values()), float)) for one in seen]
    names = [f"p{number}" for number in range(len(found))]
    return Pictures(found, [100] * len(found), names, len(found) if trained is None else trained)


def test_a_camera_belongs_to_the_blocks_that_contribute():
    owner = np.array([0, 0, 1, 1])
    looked = pictures({0: 40.0, 2: 10.1}, {1: 50.0, 3: 9.9}, {2: 0.5, 0: 0.4}, {})
    assert looked.members(owner, 2).tolist() == [
        [True, True],
        [True, False],
        [False, True],
        [False, False],
    ]
    both = pictures({0: 6.0, 1: 6.0, 2: 60.0})  # small contributions of one block add up
    assert both.members(owner, 2).tolist() == [[True, True]]


def test_held_out_photos_have_no_say_in_the_cuts():
    looked = pictures({0: 3.0, 1: 1.0}, {0: 2.0}, {1: 9.0}, trained=2)
    assert looked.contribution(3).tolist() == [5.0, 1.0, 0.0]
    assert looked.shown(np.array([False, True, True]), 3).tolist() == [True, True, False]


def test_blocks_are_as_few_as_the_memory_of_a_worker_allows():
    scene = random_scene(np.random.default_rng(1), 200)
    weight = np.ones(len(scene.anchors))
    coarse = (100 << 20, 300 << 20)

    def blocks(worker):
        rows, columns = counts_for_memory(scene, weight, UP, coarse, worker << 20)
        return rows * columns

    assert blocks(100_000) == 2
    assert blocks(400) == 4  # 1.5 x 4 x 200 MiB in parts of 300
    assert blocks(200) >= 12
    with pytest.raises(UsageError, match="a worker has 90 MiB, and needs 100 before it trains"):
        blocks(90)


def test_a_plan_is_read_as_it_was_written(tmp_path):
    assert read_plan(tmp_path) is None
    photos = {"0-0": ["a", "b"], "1-0": ["b"]}
    plan = Plan(CUTS, photos, {"0-0": [], "1-0": ["c"]})
    plan.write(tmp_path)
    assert read_plan(tmp_path) == plan
    (tmp_path / "plan.json").write_text('{"cuts": {}}')
    with pytest.raises(DataError, match=r"plan\.json: is damaged"):
        read_plan(tmp_path)


def test_the_merged_scene_has_every_anchor_once_from_its_owner(tmp_path):
    scene = random_scene(np.random.default_rng(2), 300)
    count = len(scene.anchors)
    cuts = cut_scene(scene.anchors.position, np.ones(count), UP, (2, 2))
    for number, name in enumerate(cuts.names):
        # each block has the others' anchors, too, with other features
        anchors = take(scene.anchors, np.random.default_rng(number).permutation(count))
        foreign = cuts.owner(anchors.position) != number
        anchors.feature[foreign] += 1000
        (tmp_path / name).mkdir()
        save_scene(tmp_path / name / "scene.npz", replace(scene, anchors=anchors))
    merged = merged_scene(tmp_path, cuts, scene)
    for name, array in sort_anchors(scene.anchors).items():
        np.testing.assert_array_equal(getattr(merged.anchors, name), array)
    other = replace(scene, scales=QuantizationScales(feature=3.0))
    save_scene(tmp_path / "1-0" / "scene.npz", other)
    with pytest.raises(DataError, match="other units than the coarse scene"):
        merged_scene(tmp_path, cuts, scene)
