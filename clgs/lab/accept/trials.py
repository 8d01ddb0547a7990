"""The list of trials of `clgs accept`, and the line that each shows."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Any

from clgs.errors import ClgsError
from clgs.lab.accept.trial import Trial
from clgs.lab.bench.gsplat import has_gsplat
from clgs.lab.selftest import SHIPPED
from clgs.lab.selftest.conformance import differences, from_record

STEPS = 20
"""Steps of a training, which runs twice and must give the same file."""

STARTED = (1000, 64)
"""Gaussians, and pixels of the picture's edge, of the step that is timed from a cold start."""

LARGE = "1920x1080"
"""Pixels of the large picture."""


@dataclass(frozen=True)
class Size:
    """How much work the parts do: Gaussians, the picture's edge in pixels, and repetitions.

    elements: of stages that are timed alone; large: Gaussians and pixels of the large step; points:
    that a training starts from.
    """

    gaussians: int
    edge: int
    elements: int
    large: tuple[int, str]
    repeats: int
    points: int


WHOLE = Size(200_000, 400, 1_000_000, (1_000_000, LARGE), 15, 10_000)
QUICK = Size(20_000, 128, 100_000, (50_000, "480x270"), 5, 1_000)


def trials(device: str, folder: Path, size: Size, data: list[str]) -> list[Trial]:
    """List all trials.

    Args:
        device: as for ``--device``.
        folder: that they write into, with the photos in ``photos``.
        size: of the work.
        data: arguments of a training on the user's own data; empty: none is made.
    """
    on = ("--device", device)

    def file(name: str) -> str:
        return str(folder / f"{name}.json")

    def step(name: str, work: tuple[int, int | str], repeats: int = 1, kind: str = "step") -> Trial:
        counts = zip(("--gaussians", "--size", "--repeats"), (*work, repeats), strict=True)
        words = ("bench", kind, *on, *map(str, chain(*counts)), "--json", file(name))
        return Trial(name, words, partial(show_step, name))

    def start(name: str, line: str) -> Trial:
        return replace(step(name, STARTED), summary=lambda folder: line, caches=folder / "caches")

    def training(name: str) -> Trial:
        words = ("train", str(folder / "photos"), "-o", str(folder / name), "--steps", str(STEPS))
        points = ("--start-points", str(size.points))
        return Trial(name, (*words, *points, *on), partial(show_hash, name))

    usual = size.gaussians, size.edge
    sizes = ("--gaussians", size.gaussians, "--size", size.edge)
    ops = (*sizes, "--elements", size.elements, "--repeats", size.repeats)
    hashes = file("conformance")
    found = [
        Trial("machine", ("doctor", "--json"), show_machine),
        start("first start", "kernels compiled"),
        start("second start", "kernels compiled before"),
        Trial("selftest", ("selftest", *on, "--json", file("selftest")), show_selftest),
        Trial("conformance", ("conformance", *on, "-o", hashes), show_conformance),
        Trial(
            "conformance again",
            ("conformance", *on, "--check", hashes),
            lambda folder: "the same bits",
        ),
        training("training"),
        training("training again"),
        Trial(
            "stages", ("bench", "ops", *on, *map(str, ops), "--json", file("stages")), show_stages
        ),
        step("step", usual, size.repeats),
        step("large step", size.large, size.repeats),
    ]
    if has_gsplat():
        for name, work in (("gsplat", usual), ("gsplat large", size.large)):
            timed = step(name, work, size.repeats, "gsplat")
            found.append(replace(timed, summary=partial(show_gsplat, name)))
    if data:
        words = ("train", *data, "-o", str(folder / "data"), *on)
        found.append(Trial("data", words, show_data))
    return found


def _read(folder: Path, name: str) -> Any:
    return json.loads((folder / f"{name}.json").read_text())


def show_machine(folder: Path) -> str:
    """The system, and what the doctor found."""
    facts = json.loads((folder / "machine.out").read_text())
    return f"{facts['machine']['system']}, {len(facts['findings'])} findings"


def show_step(name: str, folder: Path) -> str:
    """Times of a step and of a picture."""
    times = _read(folder, name)
    return (
        f"{times['step']:.2f} ms a step (kernels {sum(times['kernels'].values()):.2f}, "
        f"host {times['host']:.2f}), {times['render']:.2f} ms a picture, "
        f"{times['gaussians']:,} Gaussians"
    )


def show_gsplat(name: str, folder: Path) -> str:
    """Our times over gsplat's."""
    found = _read(folder, name)
    ours, theirs = found["clgs"], found["gsplat"]
    forward = ours["blend forward"] / theirs["forward"]
    backward = ours["blend backward"] / theirs["backward"]
    return (
        f"{ours['step'] / theirs['step']:.2f} of gsplat's step, rasteriser forward {forward:.2f}, "
        f"backward {backward:.2f}; pictures differ by {theirs['difference']:.1e}"
    )


def show_selftest(folder: Path) -> str:
    """The number of checks."""
    checks = [one for each in _read(folder, "selftest")["devices"] for one in each["checks"]]
    return f"{len(checks)} checks within their limits"


def show_conformance(folder: Path) -> str:
    """How far the bits are those that clgs comes with."""
    found = from_record(_read(folder, "conformance"))
    different = differences(found, from_record(json.loads(SHIPPED.read_text())))
    first = f", first {different[0].place}" if different else ""
    return f"{len(found) - len(different)} of {len(found)} tensors as on PoCL{first}"


def show_hash(name: str, folder: Path) -> str:
    """The hash of the file, which the second training shares with the first."""
    found = [
        hashlib.sha256((run / "scene.clgs").read_bytes()).hexdigest()
        for run in (folder / "training", folder / name)
        if run.exists()
    ]
    if len(set(found)) > 1:
        raise ClgsError(f"{STEPS} steps gave another file than before: {found[1][:16]}")
    return f"{STEPS} steps: {found[-1][:16]}"


def show_stages(folder: Path) -> str:
    """The share of the device's limit that stages reach."""
    stages = [one for each in _read(folder, "stages")["devices"] for one in each["stages"]]
    shares = [one["share"]["of_limit"] for one in stages if one["share"]]
    return f"{len(stages)} stages, {100 * median(shares):.0f} % of the device's limit, the median"


def show_data(folder: Path) -> str:
    """Time, quality and size of the training on the user's data."""
    found = _read(folder, "data/results")
    return (
        f"{found['steps']} steps in {found['train_seconds']:.0f} s, {found['psnr']:.2f} dB, "
        f"{found['bytes']:,} bytes, {found['peak_memory_bytes'] / 2**20:.0f} MiB"
    )
