#!/usr/bin/env python3
"""Milliseconds of steps of a batch of two: on a device, and on its halves that stand for two cards.

Steps are those that would follow a trained scene's, with learning rates too small to change it;
statistics are taken, as before anchors become integers. The three ways take turns:

- one view: a step of one view on the whole device, two times
- batch of 2: on the whole device
- two halves: a view on each, which are sub-devices of half its cores

Then come the parts of a step on two halves, one after the other on idle devices, and the bytes that
are exchanged.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import pyopencl as cl

import clgs
from clgs.data.dataset import Dataset, load_dataset
from clgs.data.origin import repose
from clgs.lab.bench.step import STILL, WARM_UP
from clgs.lab.figures import take_turns
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.scene.scene import Scene
from clgs.train.config import TrainConfig, preset
from clgs.train.run.load import state_of_scene
from clgs.train.run.trainer import Trainer
from clgs.train.state.run_state import ANCHOR_GROUPS
from clgs.train.step.batch import Batch, hand_out


def trainer(dataset: Dataset, config: TrainConfig, scene: Scene, *devices: Device) -> Trainer:
    """A trainer of a batch in the middle of its statistics phase."""
    first, *others = devices
    state = state_of_scene(first, dataset, config, scene, config.statistics_start + 1)
    made = Trainer(first, dataset, config, state=state, others=others)
    list(made.steps(WARM_UP))
    return made


def parts(two: Trainer, repeats: int) -> None:
    """Print the median milliseconds and the bytes of what a step on two devices does."""
    (other,), first, state = two.queue._others, two.device, two.state
    found: dict[str, list[float]] = {}

    def done(part: str, start: float) -> None:
        first.finish()
        other.device.finish()
        found.setdefault(part, []).append(1e3 * (time.perf_counter() - start))

    for _ in range(repeats):
        step = state.step + 1
        given, scene = two.queue.next_input(state, step), two.rounding.scene_at(state, step)
        own = two.queue._looks.enqueue(scene, None, step, given.views[0], two.queue.room)
        batch = Batch(first, 2)
        batch.add(own)
        first.finish()
        start = time.perf_counter()
        hand_out(first, [other], scene, None)
        done("scene handed out", start)
        start = time.perf_counter()
        other.begin(step, given.views[1], False, two.queue.room)
        done("view of a half", start)
        start = time.perf_counter()
        look, _ = other.fetch(first)
        done("what it left brought back", start)
        start = time.perf_counter()
        batch.add(look)
        done("gradients added", start)
    for name, times in found.items():
        print(f"  {name}: median {median(times):.1f}, least {min(times):.1f} ms")
    assert look.seen is not None
    gradients = [getattr(look.gradients, f"d_{name}") for name in (*ANCHOR_GROUPS, "weights")]
    seen = [array for array in vars(look.seen).values() if isinstance(array, DeviceArray)]
    for name, arrays in (
        ("scene", [array for _, array in scene.items()]),
        ("gradients", gradients),
        ("statistics", seen),
    ):
        print(f"  {name}: {sum(array.nbytes for array in arrays) / 1e6:.1f} MB")


def main() -> None:
    """Parse the arguments, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scene", type=Path, help="a trained scene, .clgs")
    parser.add_argument("data", type=Path, help="the dataset that it was trained on")
    parser.add_argument("--downscale", type=int, default=4, help="of the photos (default: 4)")
    parser.add_argument("--repeats", type=int, default=7, help="rounds of all ways (default: 7)")
    args = parser.parse_args()
    scene = clgs.decode(args.scene.read_bytes()).dequantize()
    config = replace(preset("default"), learning_rates=STILL)
    dataset = repose(load_dataset(args.data, downscale=args.downscale), scene.transform)
    config = config.for_dataset(dataset.kind)
    whole = Device()
    halves = [
        Device(specialisation=whole.specialisation, cl_device=part)
        for part in whole.cl_device.create_sub_devices(
            [cl.device_partition_property.EQUALLY, whole.cl_device.max_compute_units // 2]
        )
    ]
    pair = replace(config, batch=2)
    ways = {
        "one view, twice": (trainer(dataset, config, scene, whole), 2),
        "batch of 2": (trainer(dataset, pair, scene, whole), 1),
        "two halves": (trainer(dataset, pair, scene, *halves), 1),
    }
    units = [each.cl_device.max_compute_units for each in (whole, *halves)]
    print(f"{whole.name}, units {units}; {len(scene.anchors)} anchors")
    steps = 4
    tasks = {
        name: lambda one=one, count=count: list(one.steps(steps * count))
        for name, (one, count) in ways.items()
    }
    for name, times in take_turns(tasks, args.repeats).items():
        each = [milliseconds / steps for milliseconds in times]
        print(f"{name}: median {median(each):.0f}, least {min(each):.0f} ms for two views")
    parts(ways["two halves"][0], args.repeats)


if __name__ == "__main__":
    main()
