#!/usr/bin/env python3
"""Milliseconds of training steps and of pictures on a trained scene and the photos it was made of.

Steps are those that would follow the run's last one, with learning rates too small to change the
scene; the views are dealt as in training. Stages are timed in further steps, with a wait after
each. Then comes what each skip leaves of the work on a view.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from clgs.data.origin import repose
from clgs.lab.bench.step import STILL, show, time_steps
from clgs.lab.savings import savings
from clgs.opencl.device import Device
from clgs.train.config import from_toml
from clgs.train.run.load import load_for, state_of_scene
from clgs.train.run.trainer import Trainer
from clgs.workflow.scenes import read_run


def main() -> None:
    """Parse the arguments, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="run folder of a finished training")
    parser.add_argument("data", type=Path, help="the dataset that it was trained on")
    parser.add_argument("--steps", type=int, default=40, help="of each kind (default: 40)")
    parser.add_argument("--device", help="number or part of the name, see `clgs devices`")
    args = parser.parse_args()
    device = Device(args.device)
    text = (args.run / "config.toml").read_text(encoding="utf-8")
    config = replace(from_toml(text), learning_rates=STILL)
    scene = read_run(args.run)[0]
    dataset = repose(load_for(config, args.data, args.run), scene.transform)
    state = state_of_scene(device, dataset, config, scene.dequantize(), config.steps)
    trainer = Trainer(device, dataset, config, state=state)
    title = f"{device.name}, {trainer.parameters.count} anchors"
    show(title, time_steps(trainer, args.steps), savings(trainer))


if __name__ == "__main__":
    main()
