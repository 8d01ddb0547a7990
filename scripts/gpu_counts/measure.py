"""Run the scenes of a checkout: what its kernels do on small ones, how large the benches are."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from subprocess import run
from typing import Any

import oclgrind
import sass

HERE = Path(__file__).resolve().parent
SMALL = {"32x32": (1_280, 32, 32), "48x48": (2_880, 48, 48), "64x64": (5_120, 64, 64)}
"""Gaussians, width and height: as many Gaussians per pixel as the first bench has."""

BENCHES = {
    "200,000 at 400x400": (200_000, 400, 400),
    "1,000,000 at 1920x1080": (1_000_000, 1920, 1080),
}

SAME_LOSS = 1e-5

ELEMENTS = (16_384, 65_536)
"""Sorted and summed by themselves: in small scenes these kernels have too few work-groups."""

Json = dict[str, Any]


def state(source: Path) -> Json:
    """All that is recorded of a checkout."""
    say(f"{source}: instructions of sm_90")
    found: Json = {"sass": sass.instructions(source)}
    found["commit"] = last_commit(source)
    with tempfile.TemporaryDirectory() as folder:
        plugin = oclgrind.build(Path(folder))
        small = {**SMALL, **{f"{count} elements": (count, 0, 0) for count in ELEMENTS}}
        scenes = {name: counted(source, size, Path(folder), plugin) for name, size in small.items()}
        found["scenes"] = {name: scenes[name] for name in SMALL}
        found["elements"] = {name: each for name, each in scenes.items() if name not in SMALL}
        found["benches"] = {
            name: bench(source, size, Path(folder)) for name, size in BENCHES.items()
        }
    return found


def bench(source: Path, size: tuple[int, int, int], folder: Path) -> Json:
    """The launches of a step of a bench and its units."""
    say(f"{source}: the sizes of {size[0]} Gaussians")
    scene = run_scene(source, "default", size, 2, folder, None)
    kernels = {key: {"launches": each} for key, each in grouped(scene["launches"]).items()}
    return {"kernels": kernels, "units": scene["units"]}


def last_commit(source: Path) -> str:
    """The one that last changed what is counted."""
    command = ["git", "-C", str(source), "log", "-1", "--format=%h", "--", "clgs", "kernels_cl"]
    return run(command, capture_output=True, text=True, check=True).stdout.strip()


def counted(source: Path, size: tuple[int, int, int], folder: Path, plugin: Path) -> Json:
    """Units of a small scene, and of every kernel its launches and their counts."""
    say(f"{source}: {size[0]} Gaussians or elements under Oclgrind")
    counts = folder / "counts.jsonl"
    environment = oclgrind.environment(folder, plugin, counts)
    seen = run_scene(source, "oclgrind", size, 1, folder, environment)
    real = run_scene(source, "default", size, 1, folder, None)
    assert abs(seen["loss"] - real["loss"]) < SAME_LOSS, "Oclgrind computes something else"
    launches = seen["launches"]
    lines = counts.read_text(encoding="utf-8").splitlines()
    kernels: dict[str, Json] = {key: {"launches": each} for key, each in grouped(launches).items()}
    for launch, line in zip(launches, lines, strict=True):
        one = json.loads(line)
        assert one["kernel"] == launch["kernel"], "the plugin saw other launches"
        add(kernels[key_of(launch)].setdefault("sums", {}), one["sums"])
    return {"kernels": kernels, "units": real["units"]}


def run_scene(
    source: Path,
    device: str,
    size: tuple[int, int, int],
    steps: int,
    folder: Path,
    environment: Mapping[str, str] | None,
) -> Json:
    """What ``scene.py`` writes."""
    python, file = source / ".venv" / "bin" / "python", folder / "scene.json"
    command = [
        str(python if python.exists() else sys.executable),
        str(HERE / "scene.py"),
        *(device, *map(str, size), str(steps), str(file)),
    ]
    run(command, check=True, cwd=source, env=dict(environment or os.environ))
    return dict(json.loads(file.read_text(encoding="utf-8")))


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
