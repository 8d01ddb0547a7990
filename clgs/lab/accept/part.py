"""A part of `clgs accept`: a command of clgs in a process of its own, and what came of it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from clgs.errors import ClgsError

MOST_SECONDS = 1800.0
"""After so many seconds a part is stopped: a driver may hang."""

KEPT_CHARACTERS = 4000
"""Of what a part printed, the end is kept."""

CACHES = ("POCL_CACHE_DIR", "CUDA_CACHE_PATH", "NEO_CACHE_DIR", "AMD_COMGR_CACHE_DIR")
"""Folders in which drivers keep compiled kernels; pyopencl's lies below XDG_CACHE_HOME."""

_CODE = "import sys; sys.path[:] = {path!r}; from clgs.cli.main import main; sys.exit(main())"


@dataclass(frozen=True)
class Part:
    """What is run: ``clgs WORDS``.

    name; words: arguments; tell: one line from the folder that all parts write into, once the
    command has succeeded, and raises ClgsError if what it finds there is wrong; caches: a folder
    in place of the drivers' own for compiled kernels.
    """

    name: str
    words: tuple[str, ...]
    tell: Callable[[Path], str]
    caches: Path | None = None


@dataclass(frozen=True)
class Outcome:
    """What came of a part: its exit code, negative for a signal, None if it took too long."""

    name: str
    words: tuple[str, ...]
    passed: bool
    exit_code: int | None
    seconds: float
    told: str
    printed: str = field(repr=False)


def run_part(part: Part, folder: Path, seconds: float = MOST_SECONDS) -> Outcome:
    """Run a part to its end, whatever that is; its standard output goes to ``folder``/NAME.out."""
    out = folder / f"{part.name}.out"
    environment = dict(os.environ)
    if part.caches:
        environment |= dict.fromkeys((*CACHES, "XDG_CACHE_HOME"), str(part.caches))
    code = _CODE.format(path=sys.path)
    start = time.perf_counter()
    exit_code: int | None
    with out.open("wb") as output, (folder / f"{part.name}.err").open("wb+") as errors:
        try:
            exit_code = subprocess.run(
                [sys.executable, "-c", code, *part.words],
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
    passed, told = exit_code == 0, _failure(exit_code, printed)
    if passed:
        try:
            told = part.tell(folder)
        except ClgsError as error:
            passed, told = False, str(error)
        except (OSError, ValueError, LookupError, TypeError) as error:
            passed, told = False, f"its figures cannot be read: {type(error).__name__}"
    end = printed[-KEPT_CHARACTERS:]
    return Outcome(part.name, part.words, passed, exit_code, round(spent, 2), told, end)


def _failure(exit_code: int | None, printed: str) -> str:
    if exit_code is None:
        return "took too long and was stopped"
    if exit_code < 0:
        return f"crashed: signal {-exit_code}"
    lines = printed.strip().splitlines() or ["it said nothing"]
    return f"exit code {exit_code}: {lines[-1].removeprefix('clgs: error: ')}"
