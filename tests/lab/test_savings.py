"""What skips leave out of the work on a view."""

from __future__ import annotations

from dataclasses import replace

import pytest

from clgs.data.dataset import load_dataset
from clgs.lab.savings import savings
from clgs.train.config import TrainConfig, preset
from clgs.train.run.load import with_points
from clgs.train.run.trainer import Trainer
from tests.small_scene import write_scene

STEPS = 240


@pytest.mark.slow
def test_savings_count_no_more_than_all(tmp_path, open_device):
    dataset = with_points(load_dataset(write_scene(tmp_path)), TrainConfig(start_points=4000))
    config = replace(preset("default").scaled(STEPS), voxel=0.02).for_dataset(dataset.kind)
    trainer = Trainer(open_device("cpu"), dataset, config)
    list(trainer.steps(12))
    found = {(one.skip, one.unit): one for one in savings(trainer)}
    assert all(0 <= one.done <= one.without for one in found.values())
    assert found["slots", "rows of color and shape"].share > 0
    assert found["units", "pairs visited, forward"].share > 0
    assert found["exact_tiles", "tile entries"].share > 0
    frame = trainer.render_next()
    entries = found["exact_tiles", "tile entries"]
    assert entries.done == len(frame.tiles.gaussian)
    assert found["(bound)", "pairs blended of visited"].done > 0
    rate = found["rate interval", "steps with the rate proxy"]
    assert (rate.done, rate.without) == (STEPS // 20, STEPS // 2)
