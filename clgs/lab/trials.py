"""The trials of `clgs accept`: each is a command of clgs in a process of its own.

Trials run one after the other. What each found is on disk as soon as it ends. They train on a few
photos of nothing with known poses: enough to train on anywhere, the same everywhere.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from clgs.cli.tell import tell
from clgs.errors import ClgsError, DeviceError
from clgs.exports.pictures import save_png
from clgs.files import write_json
from clgs.lab.bench.gsplat import has_gsplat
from clgs.lab.selftest import SHIPPED
from clgs.lab.selftest.conformance import differences, from_record
from clgs.machine import host_facts
from clgs.opencl.choose import choose_device, list_devices

VIEWS, EDGE = 8, 64
DISTANCE = 4.0


def write_photos(folder: Path) -> None:
    """A Blender data set of VIEWS photos in the new folder ``folder``.

    Its pixels are made of integers alone, so that every machine writes the same.
    """
    (folder / "train").mkdir(parents=True)
    frames = []
    for view in range(VIEWS):
        y, x = np.mgrid[:EDGE, :EDGE]
        waves = np.stack([8 * x + 3 * y + 20 * view, 5 * y + 9 * view, 4 * (x + y)], axis=-1) % 512
        save_png(
            folder / "train" / f"{view}.png", np.asarray(np.minimum(waves, 511 - waves), np.uint8)
        )
        # camera to world, looking at the origin from one of eight sides (x right, y up, z back)
        right = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)][view]
        length = (right[0] ** 2 + right[1] ** 2) ** 0.5
        c, s = right[0] / length, right[1] / length
        back = [s, -c, 0.0]
        columns = [[c, s, 0.0], [0.0, 0.0, 1.0], back, [DISTANCE * one for one in back]]
        rows = [[column[i] for column in columns] for i in range(3)]
        frames.append(
            {"file_path": f"./train/{view}", "transform_matrix": [*rows, [0.0, 0.0, 0.0, 1.0]]}
        )
    document = {"camera_angle_x": 0.8, "frames": frames}
    (folder / "transforms_train.json").write_text(json.dumps(document))


FORMAT = "clgs accept 2"
KEPT = (
    "conformance", "selftest", "stages", "step", "large step", "first start", "second start",
    "gsplat", "gsplat large",
)  # fmt: skip
"""Trials whose figures go into the record, in addition to the line that is shown."""

MOST_SECONDS = 1800.0
"""A trial that takes longer is stopped, as a driver may hang."""

KEPT_CHARACTERS = 4000
"""The end of what a trial printed is kept, up to this length."""

CACHES = ("POCL_CACHE_DIR", "CUDA_CACHE_PATH", "NEO_CACHE_DIR", "AMD_COMGR_CACHE_DIR")
"""Folders in which drivers keep compiled kernels; pyopencl's lies below XDG_CACHE_HOME."""

_CODE = "import sys; sys.path[:] = {path!r}; from clgs.cli.main import main; sys.exit(main())"


@dataclass(frozen=True)
class Trial:
    """A command to run: ``clgs WORDS``.

    summary: makes one line from the folder that all trials write into. It is called if the command
    succeeded, and raises ClgsError if what it finds there is wrong. caches: the folder in which
    drivers keep compiled kernels, in place of their own.
    """

    name: str
    words: tuple[str, ...]
    summary: Callable[[Path], str]
    caches: Path | None = None


@dataclass(frozen=True)
class Outcome:
    """How a trial ended: its exit code, negative for a signal, None if it took too long."""

    name: str
    words: tuple[str, ...]
    passed: bool
    exit_code: int | None
    seconds: float
    summary: str
    printed: str = field(repr=False)


def run_trial(trial: Trial, folder: Path, seconds: float = MOST_SECONDS) -> Outcome:
    """Run a trial to its end; its standard output goes to ``folder``/NAME.out."""
    out = folder / f"{trial.name}.out"
    environment = dict(os.environ)
    if trial.caches:
        environment |= dict.fromkeys((*CACHES, "XDG_CACHE_HOME"), str(trial.caches))
    code = _CODE.format(path=sys.path)
    start = time.perf_counter()
    exit_code: int | None
    with out.open("wb") as output, (folder / f"{trial.name}.err").open("wb+") as errors:
        try:
            exit_code = subprocess.run(
                [sys.executable, "-c", code, *trial.words],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=errors,
                env=environment,
                timeout=seconds,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            exit_code = None
        spent = time.perf_counter() - start
        errors.seek(0)
        printed = out.read_text(errors="replace") + errors.read().decode(errors="replace")
    passed = exit_code == 0
    if exit_code is None:
        summary = "took too long and was stopped"
    elif exit_code < 0:
        summary = f"crashed: signal {-exit_code}"
    elif exit_code > 0:
        lines = printed.strip().splitlines() or ["it said nothing"]
        summary = f"exit code {exit_code}: {lines[-1].removeprefix('clgs: error: ')}"
    else:
        try:
            summary = trial.summary(folder)
        except ClgsError as error:
            passed, summary = False, str(error)
        except (OSError, ValueError, LookupError, TypeError) as error:
            passed, summary = False, f"its figures cannot be read: {type(error).__name__}"
    end = printed[-KEPT_CHARACTERS:]
    return Outcome(trial.name, trial.words, passed, exit_code, round(spent, 2), summary, end)


def chosen_device(name: str | None, folder: Path) -> dict[str, Any]:
    """What `clgs devices` says of the device of that number or name, or of the usual one.

    Raises:
        DeviceError: there is none, or asking for it crashed.
        UsageError: ``name`` is empty.
    """
    outcome = run_trial(Trial("devices", ("devices", "--json"), lambda folder: ""), folder)
    if not outcome.passed:
        found_by = "; scripts/accept_gpu.sh finds out which driver crashes, and goes on without it"
        remedy = found_by if "signal" in outcome.summary else ""
        raise DeviceError(f"`clgs devices`: {outcome.summary}{remedy}")
    found = json.loads((folder / "devices.out").read_text())
    number = list_devices().index(choose_device(name))  # which did not crash in the trial
    return dict(found[number])


def run_trials(
    todo: list[Trial], folder: Path, device: dict[str, Any], output: Path
) -> list[Outcome]:
    """Run all trials and name each; ``output`` always holds every trial that has ended.

    Names of the user's own folders may be in what trials printed. ``complete`` in the file says
    whether it has all trials; it has not after an interruption.
    """
    outcomes: list[Outcome] = []
    parts = []
    for number, trial in enumerate(todo, 1):
        tell(f"[{number}/{len(todo)}] {trial.name} ...")
        outcome = run_trial(trial, folder)
        outcomes.append(outcome)
        part = asdict(outcome)
        part["words"] = [word.replace(str(folder), "FOLDER") for word in outcome.words]
        part["printed"] = outcome.printed.replace(str(folder), "FOLDER")
        figures = folder / f"{outcome.name}.json"
        if outcome.name in KEPT and figures.exists():
            part["figures"] = json.loads(figures.read_text())
        parts.append(part)
        complete = number == len(todo)
        head = {"format": FORMAT, "complete": complete, **host_facts(), "device": device}
        write_json(output, head | {"parts": parts})
    return outcomes


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
