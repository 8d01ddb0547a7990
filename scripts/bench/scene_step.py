#!/usr/bin/env python3
"""Milliseconds of training steps and of pictures on a trained scene and the photos it was made of.

Steps are those that would follow the run's last one, with learning rates too small to change the
scene; the views are dealt as in training. "waiting" makes every array to measure, which waits for
the device within each step; "ahead" is what training does. Both take turns.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from statistics import mean, median

from clgs.data.origin import repose
from clgs.lab.bench.step import STILL, WARM_UP, stream_times
from clgs.opencl.device import Device
from clgs.render.renderer import Renderer
from clgs.train.config import from_toml
from clgs.train.run.load import load_for
from clgs.train.run.start import state_of_scene
from clgs.train.run.trainer import Trainer
from clgs.workflow.scenes import read_run

ROUNDS = 2


def main() -> None:
    """Parse the arguments, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="run folder of a finished training")
    parser.add_argument("data", type=Path, help="the dataset that it was trained on")
    parser.add_argument("--steps", type=int, default=20, help="a round")
    parser.add_argument("--adam", choices=("dense", "visible"), default="dense")
    parser.add_argument("--device")
    args = parser.parse_args()
    device = Device(args.device)
    trainers = {mode: trainer(device, args, mode == "ahead") for mode in ("waiting", "ahead")}
    times: dict[str, list[float]] = {mode: [] for mode in trainers}
    for _ in range(ROUNDS):
        for mode, one in trainers.items():
            times[mode] += stream_times(one, args.steps)
    print(f"{device.name}, {trainers['ahead'].parameters.count} anchors")
    for mode, values in times.items():
        print(f"step, {mode}: median {median(values):.1f}, mean {mean(values):.1f} ms")
    values = pictures(device, args, trainers["ahead"])
    print(f"render only: median {median(values):.1f}, mean {mean(values):.1f} ms")
    device.profile.enabled = True
    stream_times(trainers["waiting"], args.steps)
    for name, calls, milliseconds, _ in device.profile.rows():
        print(f"  {name:16} {milliseconds:8.2f} ms, {calls} calls")


def trainer(device: Device, args: argparse.Namespace, ahead: bool) -> Trainer:
    """A trainer that continues the run."""
    config = from_toml((args.run / "config.toml").read_text(encoding="utf-8"))
    config = replace(config, learning_rates=STILL, adam=args.adam)
    scene = read_run(args.run)[0]
    loaded = load_for(config, args.data, args.run)
    dataset = repose(loaded, scene.transform)
    state = state_of_scene(device, dataset, config, scene.dequantize(), config.steps)
    return Trainer(device, dataset, config, ahead, state)


def pictures(device: Device, args: argparse.Namespace, one: Trainer) -> list[float]:
    """Milliseconds of a picture of each of the first training views, after a few to warm up."""
    renderer = Renderer(device, read_run(args.run)[0].dequantize())
    times = []
    for view in one.dataset.train[: args.steps + WARM_UP]:
        start = time.perf_counter()
        renderer.render(view.camera)
        times.append(1e3 * (time.perf_counter() - start))
    return times[WARM_UP:]


if __name__ == "__main__":
    main()
