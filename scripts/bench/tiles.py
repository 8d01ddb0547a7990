#!/usr/bin/env python3
"""Milliseconds per million intersections from projected Gaussians to finished tile lists.

The whole stage is all that ``clgs.ops.tiles.forward`` does: footprints with the exact test of every
tile, the prefix sum, the sort by depth, the pass by tile and the ranges. NumPy sorts
the same lists from finished keys, tile * 2^32 + bits of the depth, which is the stable order that
the kernels give. Rounds are interleaved.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from statistics import median

import numpy as np

from clgs.lab.synthetic.gaussians import projected_scene
from clgs.opencl.device import Device
from clgs.ops import tiles
from clgs.ops.project import Projected

SCENES = {
    "200k small, 400x400": (200_000, 400, 1.1),
    "200k, 800x800": (200_000, 800, 5.0),
    "300k padded by half, 400x400": (200_000, 400, 1.1),
    "50k large, 800x800": (50_000, 800, 20.0),
}
"""Number of Gaussians, edge of the image, median longer sigma in pixels."""


def milliseconds(device: Device, work: Callable[[], object]) -> float:
    """Wall time of ``work`` with everything that it enqueued."""
    device.finish()
    start = time.perf_counter()
    work()
    device.finish()
    return 1e3 * (time.perf_counter() - start)


def numpy_keys(device: Device, lists: tiles.TileLists, depth: np.ndarray) -> np.ndarray:
    """Tile and depth of every intersection, in the order of the Gaussians."""
    gaussian, row, ranges = (
        device.download(array) for array in (lists.gaussian, lists.row, lists.tile_range)
    )
    tile = np.repeat(np.arange(len(ranges) - 1, dtype=np.uint64), np.diff(ranges))
    keys = np.empty(len(row), np.uint64)
    keys[row] = tile << np.uint64(32) | depth.view(np.uint32)[gaussian].astype(np.uint64)
    return keys


def bench(device: Device, name: str, rounds: int) -> None:
    """Print one line for a scene."""
    count, edge, sigma = SCENES[name]
    scene = projected_scene(np.random.default_rng(0), count, edge, edge, sigma)
    arrays = {
        field: np.concatenate([values, np.zeros_like(values[: count // 2])])
        if "padded" in name
        else values
        for field, values in vars(scene).items()
    }
    on_device = {field: device.upload(values) for field, values in arrays.items()}
    projected = Projected(**on_device)
    lists = tiles.forward(device, projected, (edge, edge))
    total = len(lists.gaussian)
    keys = numpy_keys(device, lists, arrays["depth"])
    work: dict[str, Callable[[], object]] = {
        "whole stage": lambda: tiles.forward(device, projected, (edge, edge)),
        "numpy stable argsort": lambda: np.argsort(keys, kind="stable"),
        "numpy argsort": lambda: np.argsort(keys),
    }
    times: dict[str, list[float]] = {one: [] for one in work}
    for _ in range(rounds):
        for one, call in work.items():
            times[one].append(milliseconds(device, call))
    print(f"{name}: {total} intersections, {tiles.tile_count(edge, edge)} tiles")
    for one, values in times.items():
        middle = median(values)
        print(f"  {one:24s} {middle:8.2f} ms  {1e6 * middle / total:7.2f} ms per million")


def main() -> None:
    """Measure every scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    device = Device()
    print(f"{device.name}, specialisation {device.specialisation}, {options.rounds} rounds")
    for name in SCENES:
        bench(device, name, options.rounds)


if __name__ == "__main__":
    main()
