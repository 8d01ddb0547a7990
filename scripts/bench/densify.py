#!/usr/bin/env python3
"""Milliseconds that growing and pruning take, on a synthetic scene of 200,000 Gaussians.

Sums of gradients are random; the threshold lets so many slots ask that the anchors grow by about a
twentieth. Every time begins with the same anchors and sums. "compact" is leaving out the rows of
hidden anchors, which happens before rounds, checkpoints and the switch to integers alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median

import numpy as np

from clgs.cli.options.view import positive_int
from clgs.constants import K_OFFSETS
from clgs.lab.bench.step import synthetic_trainer
from clgs.opencl.device import Device
from clgs.ops.density import Statistics
from clgs.train.density.grow_and_prune import replace_anchors
from clgs.train.run.trainer import Trainer

SHARE_ASKING = 0.02
"""Of the slots; as about a third of the slots are seen often enough, 6 % of those."""

SEEN, VISITED = 60, 120
"""Largest counts of slots and of anchors."""


def main() -> None:
    """Parse the arguments, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gaussians", type=positive_int, default=200_000)
    parser.add_argument("--repeats", type=positive_int, default=21)
    parser.add_argument("--device")
    args = parser.parse_args()
    device = Device(args.device)
    trainer = synthetic_trainer(device, args.gaussians, 400, 0)
    times: dict[str, list[float]] = {"grow and prune": [], "compact": []}
    start = trainer.parameters.count
    for _ in range(args.repeats):
        trainer = synthetic_trainer(device, args.gaussians, 400, 0)
        change, compact = changes(trainer)
        times["grow and prune"].append(milliseconds(device, change))
        rows, after = trainer.parameters.rows, trainer.parameters.count
        times["compact"].append(milliseconds(device, compact))
    print(f"{device.name}: {start} anchors, then {after} of {rows} rows")
    for name, values in times.items():
        print(f"{name}: median {median(values):.1f} ms ({min(values):.1f} to {max(values):.1f})")


def changes(trainer: Trainer) -> tuple[Callable[[], None], Callable[[], None]]:
    """What grows and prunes the anchors of ``trainer``, and what leaves out hidden rows."""
    rng, count, device = np.random.default_rng(0), trainer.parameters.count, trainer.device
    seen = rng.integers(0, SEEN + 1, (count, K_OFFSETS)).astype(np.int32)
    mean = rng.random((count, K_OFFSETS)).astype(np.float32)
    threshold = float(np.quantile(mean[seen > trainer.config.slot_seen], 1 - 3 * SHARE_ASKING))
    config, frame = replace(trainer.config, growth_threshold=threshold), trainer.render_next()
    visits = rng.integers(0, VISITED + 1, count).astype(np.int32)
    opacity = 0.5 * rng.random(count).astype(np.float32) ** 0.25 * visits
    sums = mean * seen.astype(np.float32)
    host = Statistics(opacity.astype(np.float32), visits, sums, seen)
    state = trainer.state
    state.parameters = replace(state.parameters, statistics=host.map(device.upload))

    def change() -> None:
        state.parameters = replace_anchors(device, config, state.parameters, frame, state.rng)

    return change, trainer.compact


def milliseconds(device: Device, work: Callable[[], None]) -> float:
    """Of the host until the device has done all."""
    device.finish()
    start = time.perf_counter()
    work()
    device.finish()
    return 1e3 * (time.perf_counter() - start)


if __name__ == "__main__":
    main()
