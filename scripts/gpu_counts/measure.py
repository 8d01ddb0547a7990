"""Run the scenes: what the kernels do on small ones, how large the benches are."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from subprocess import run
from typing import Any

import oclgrind

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SMALL = {"32x32": (1_280, 32, 32), "48x48": (2_880, 48, 48), "64x64": (5_120, 64, 64)}
"""Gaussians, width and height: as many Gaussians per pixel as the first bench has."""

BENCHES = {
    "200,000 at 400x400": (200_000, 400, 400),
    "1,000,000 at 1920x1080": (1_000_000, 1920, 1080),
}

SCENE = "scene.py"
SAME_LOSS = 1e-5
SHOWN = 12
"""Lines of the source that are named for each kind of cost."""

ELEMENTS = (16_384, 65_536)
"""Sorted and summed by themselves: in small scenes these kernels have too few work-groups."""

Json = dict[str, Any]


def state() -> Json:
    """All that is recorded."""
    command = ["git", "-C", str(ROOT), "log", "-1", "--format=%h", "--", "clgs", "kernels_cl"]
    commit = run(command, capture_output=True, text=True, check=True).stdout.strip()
    found: Json = {"commit": commit}
    with tempfile.TemporaryDirectory() as folder:
        plugin = oclgrind.build(Path(folder))
        small = {**SMALL, **{f"{count} elements": (count, 0, 0) for count in ELEMENTS}}
        scenes = {name: counted(size, Path(folder), plugin) for name, size in small.items()}
        found["scenes"] = {name: scenes[name] for name in SMALL}
        found["elements"] = {name: each for name, each in scenes.items() if name not in SMALL}
        found["benches"] = {name: bench(size, Path(folder)) for name, size in BENCHES.items()}
    return found


def bench(size: tuple[int, int, int], folder: Path) -> Json:
    """The launches of a step of a bench and its units."""
    say(f"the sizes of {size[0]} Gaussians")
    scene = found_by(SCENE, ("default", *size, 2), folder, None)
    kernels = {key: {"launches": each} for key, each in grouped(scene["launches"]).items()}
    return {"kernels": kernels, "units": scene["units"]}


def counted(size: tuple[int, int, int], folder: Path, plugin: Path) -> Json:
    """Units of a small scene, and of every kernel its launches and their counts."""
    say(f"{size[0]} Gaussians or elements under Oclgrind")
    counts = folder / "counts.jsonl"
    environment = oclgrind.environment(folder, plugin, counts)
    seen = found_by(SCENE, ("oclgrind", *size, 1), folder, environment)
    real = found_by(SCENE, ("default", *size, 1), folder, None)
    assert abs(seen["loss"] - real["loss"]) < SAME_LOSS, "Oclgrind computes something else"
    launches = seen["launches"]
    lines = counts.read_text(encoding="utf-8").splitlines()
    kernels: dict[str, Json] = {key: {"launches": each} for key, each in grouped(launches).items()}
    for launch, line in zip(launches, lines, strict=True):
        one = json.loads(line)
        assert one["kernel"] == launch["kernel"], "the plugin saw other launches"
        add(kernels[key_of(launch)].setdefault("sums", {}), one["sums"])
    return {"kernels": kernels, "units": real["units"]}


def found_by(
    script: str, words: Sequence[object], folder: Path, environment: Mapping[str, str] | None
) -> Any:
    """What a script of this folder writes, as JSON, to the file that is its last word."""
    file = folder / "found.json"
    command = [sys.executable, HERE / script, *words, file]
    run(list(map(str, command)), check=True, env=dict(environment or os.environ))
    return json.loads(file.read_text(encoding="utf-8"))


def key_of(launch: Mapping[str, Any]) -> str:
    """A kernel in a stage: "tiles: sort_scatter"."""
    return f"{launch['stage']}: {launch['kernel']}"


def grouped(launches: list[Json]) -> dict[str, list[Json]]:
    """Launches by stage and kernel, without these two names."""
    found: dict[str, list[Json]] = {}
    for launch in launches:
        sizes = {name: launch[name] for name in ("count", "group", "items")}
        found.setdefault(key_of(launch), []).append(sizes)
    return found


def add(sums: dict[str, int], more: Mapping[str, int]) -> None:
    """Add ``more`` to ``sums``; the instructions of a kernel's code are the same every time."""
    for name, value in more.items():
        sums[name] = value if name == "static_instructions" else sums.get(name, 0) + value


def say(text: str) -> None:
    """Progress, which is no output."""
    print(f"gpu_counts: {text}", file=sys.stderr, flush=True)


def worst_lines() -> Iterator[str]:
    """Name the lines with most of each kind of cost, and their kernels, on the smallest scene."""
    found = counted_lines()
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


def counted_lines() -> dict[str, dict[str, int]]:
    """Counts by kernel and line, of a step of the smallest scene."""
    size = next(iter(SMALL.values()))
    found: dict[str, dict[str, int]] = {}
    with tempfile.TemporaryDirectory() as folder:
        plugin, counts = oclgrind.build(Path(folder)), Path(folder) / "counts.jsonl"
        environment = oclgrind.environment(Path(folder), plugin, counts)
        found_by(SCENE, ("oclgrind", *size, 1), Path(folder), environment)
        for text in counts.read_text(encoding="utf-8").splitlines():
            launch = json.loads(text)
            for line, sums in launch["lines"].items():
                add(found.setdefault(f"{launch['kernel']} {line}", {}), sums)
    return found
