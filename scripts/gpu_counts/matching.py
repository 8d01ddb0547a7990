#!/usr/bin/env python3
"""What a GPU would have to do to match two photos, counted without a GPU: matching.py [PAIRS].

The nearest descriptors of photos with 64 and 128 of them are found under Oclgrind; counts are
scaled to the photos of SIZES, PAIRS (64) of them in a launch, as ``clgs prepare`` has many.
Estimates are lower bounds that no card has confirmed.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import oclgrind
from measure import found_by
from roofline import bound

from clgs.opencl.device import Device
from clgs.ops import match

SIZES = 2048, 4096, 8192
COUNTED = match.BLOCK_ROWS, 2 * match.BLOCK_ROWS
WAYS = 2
"""One search from a photo to the other, and one back."""


def search(name: str, count: int, file: Path) -> None:
    """Find the nearest of ``count`` descriptors, and write what was found."""
    rng = np.random.default_rng(0)
    photos = [rng.integers(0, 46, (count, match.LENGTH)).astype(np.uint8) for _ in range(2)]
    device = Device(None if name == "default" else name, "gpu")
    one, other = (match.upload(device, [photo]) for photo in photos)
    found = match.nearest(device, one, other, [(0, 0)])[0]
    file.write_text(json.dumps([found.index.tolist(), found.second.tolist()]), encoding="utf-8")


def counted(count: int, folder: Path, plugin: Path) -> dict[str, float]:
    """The plugin's counts of a search."""
    counts = folder / f"{count}.jsonl"
    environment = oclgrind.environment(folder, plugin, counts)
    found = found_by("matching.py", ("oclgrind", count), folder, environment)
    real = found_by("matching.py", ("default", count), folder, None)
    assert found == real, "Oclgrind computes something else"
    (line,) = counts.read_text(encoding="utf-8").splitlines()
    return dict(json.loads(line)["sums"])


def grown(small: float, large: float, count: int) -> float:
    """A count of photos with ``count`` descriptors: each block of rows meets each of columns."""
    blocks = count // match.BLOCK_ROWS
    pairs = (large - 2 * small) / 2  # of blocks: 1 of the small search, 4 of the large one
    return pairs * blocks**2 + (small - pairs) * blocks


def main(pairs: int = 64) -> None:
    """Print a line per size."""
    if lacks := oclgrind.missing():
        raise SystemExit(f"matching: needs {', '.join(lacks)}; install it")
    with tempfile.TemporaryDirectory() as folder:
        plugin = oclgrind.build(Path(folder))
        small, large = (counted(count, Path(folder), plugin) for count in COUNTED)
    print("| descriptors | warp instructions per pair, millions | estimate per pair, µs | binds |")
    print("|---|---|---|---|")
    for count in SIZES:
        sums = {name: grown(small[name], large[name], count) for name in large}
        groups = count // match.BLOCK_ROWS * pairs
        one = bound(
            {name: pairs * value for name, value in sums.items()}, 1, groups, match.GPU_GROUP
        )
        instructions = WAYS * sums["warp_instructions"] / 1e6
        print(f"| {count} | {instructions:.1f} | {WAYS * one.time / pairs:.0f} | {one.binds} |")


if __name__ == "__main__":
    if len(sys.argv) == 4:
        search(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
    else:
        main(*map(int, sys.argv[1:]))
