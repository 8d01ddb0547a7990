"""Train a tiny scene for a few steps in both specialisations: race_scene.py DEVICE.

The steps run every kernel of training: rounding, rate proxy, growing and pruning included.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from clgs.opencl.device import Device
from clgs.testing.anchor_scene import anchor_scene, photo_dataset
from clgs.train.config import TrainConfig
from clgs.train.densify import Densifier
from clgs.train.loop import Trainer
from clgs.train.parameters import new_parameters

GAUSSIANS = 20
SIZE = 24
GROWTH_END = 2
STEPS = 3


def main(arguments: list[str]) -> int:
    """Exit code 1 where the loss is not a number."""
    scene, camera = anchor_scene(GAUSSIANS, SIZE, seed=1)
    config = replace(
        TrainConfig(),
        statistics_start=0,
        growth_start=0,
        growth_interval=1,
        growth_end=GROWTH_END,
        growth_threshold=0.0,
        slot_seen=0,
        anchor_visits=0,
        switch_step=GROWTH_END,
        rate_interval=1,
    ).for_dataset("photos")
    for specialisation in ("cpu", "gpu"):
        device = Device(*arguments[:1], specialisation=specialisation)
        trainer = Trainer(device, photo_dataset(camera, scene.anchors.position), config)
        trainer.parameters = new_parameters(device, scene.anchors, scene.mlps)
        trainer.densifier = Densifier(device, config, trainer.parameters.count)
        for _ in range(STEPS):
            result = trainer.step()
            print(f"race_scene: {specialisation}: {result}")
            if not np.isfinite(result.loss):
                return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
