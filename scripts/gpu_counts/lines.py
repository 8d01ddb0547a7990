"""The lines of the kernels that cost most, on the smallest scene."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import measure
import oclgrind

SHOWN = 12


def worst(source: Path) -> Iterator[str]:
    """For each kind of cost: the lines with most of it, and the kernel that they are part of."""
    found = counted(source)
    costs = {
        "instructions of warps": lambda line: line.get("warp_instructions", 0),
        "wavefronts of local memory by bank conflicts": lambda line: (
            line.get("local_wavefronts", 0) - line.get("local_ideal_wavefronts", 0)
        ),
        "bytes in sectors that no lane of the warp asked for": wasted,
    }
    for name, cost in costs.items():
        yield f"{name}:"
        ordered = sorted(found.items(), key=lambda item: -cost(item[1]))
        shown = [(cost(line), place) for place, line in ordered[:SHOWN] if cost(line)]
        yield from (f"  {value:>10} {place}" for value, place in shown)


def wasted(line: Mapping[str, int]) -> int:
    """Bytes of the sectors touched without those used."""
    verbs = ("read", "written")
    sectors = sum(line.get(f"global_sectors_{verb}", 0) for verb in verbs)
    return 32 * sectors - sum(line.get(f"global_used_{verb}", 0) for verb in verbs)


def counted(source: Path) -> dict[str, dict[str, int]]:
    """Counts by kernel and line, of a step of the smallest scene."""
    size = next(iter(measure.SMALL.values()))
    found: dict[str, dict[str, int]] = {}
    with tempfile.TemporaryDirectory() as folder:
        plugin, counts = oclgrind.build(Path(folder)), Path(folder) / "counts.jsonl"
        environment = oclgrind.environment(Path(folder), plugin, counts)
        measure.run_scene(source, "oclgrind", size, 1, Path(folder), environment)
        for text in counts.read_text(encoding="utf-8").splitlines():
            launch = json.loads(text)
            for line, sums in launch["lines"].items():
                measure.add(found.setdefault(f"{launch['kernel']} {line}", {}), sums)
    return found
