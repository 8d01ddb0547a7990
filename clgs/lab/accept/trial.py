"""The trials of `clgs accept`: each is a command of clgs in a process of its own.

Trials run one after the other. What each found is on disk as soon as it ends.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from clgs.cli.tell import tell
from clgs.errors import ClgsError, DeviceError
from clgs.files import write_json
from clgs.machine import host_facts
from clgs.opencl.choose import choose_device, list_devices

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
