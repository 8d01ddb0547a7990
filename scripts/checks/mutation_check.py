#!/usr/bin/env python3
"""Does the numeric suite notice bugs? Seeds them one at a time and runs the tests of the stage.

    scripts/checks/mutation_check.py [--only WORD]

Every bug of ``mutations.py`` and ``mutations_gpu.py`` is applied to a copy of kernels and ops; the
tests of its stage must fail; those of the CPU form alone cannot, and are left out, if the bug is in
the GPU form. First every bug must apply to the sources, the same tests must pass on an unchanged
copy, and fail on one that does not compile. Kernels that a bug leaves as they are come from the
tests' cache. Exit code 1 if a bug survives, or if a first condition does not hold.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from mutations import MUTATIONS, Mutation
from mutations_gpu import GPU_MUTATIONS

ROOT = Path(__file__).resolve().parents[2]
JOBS = min(os.cpu_count() or 1, 8)
CRASHES = (signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT)
STRESS = "tests/stress/test_"
SUITES = {
    "project": ["tests/ops/test_project.py", f"{STRESS}geometry.py", f"{STRESS}tiers.py"],
    "tiles": ["tests/ops/test_tiles.py", f"{STRESS}order.py"],
    "sort": ["tests/ops/test_sort.py", f"{STRESS}order.py"],
    "blend": ["tests/ops/test_blend.py", f"{STRESS}blending.py", f"{STRESS}tiers.py"],
    "scan": ["tests/ops/test_scan.py", f"{STRESS}counts.py"],
    "adam": ["tests/ops/test_adam.py", f"{STRESS}sums.py"],
    "loss": ["tests/ops/test_loss.py", f"{STRESS}sums.py"],
    "exposure": ["tests/ops/test_exposure.py"],
    "rate": ["tests/ops/test_rate.py", f"{STRESS}sums.py"],
    "quantize": ["tests/ops/test_quantize.py"],
    "neural": ["tests/ops/test_neural.py", f"{STRESS}poison.py"],
    "mlp": ["tests/ops/test_mlp.py", f"{STRESS}tiers.py"],
    "density": ["tests/ops/test_density.py"],
    "cull": ["tests/ops/test_cull.py"],
    "decode": ["tests/ops/test_project_anchors.py"],
    "growth": ["tests/ops/test_growth.py", "tests/train/density"],
}
"""Tests of every stage: all of its own, and all stress tests of its theme."""


class StaleError(Exception):
    """A bug no longer applies to the sources."""


def copy_sources(folder: Path) -> None:
    """The kernels, whole."""
    shutil.copytree(ROOT / "kernels_cl", folder / "kernels_cl")
    (folder / "clgs").mkdir()


def seed(bug: Mutation, folder: Path) -> None:
    """Write the changed file into the copy.

    Raises:
        StaleError: the text is not there, or not as often as it should be.
    """
    text = (ROOT / bug.file).read_text(encoding="utf-8")
    found = text.count(bug.old)
    if found != bug.times:
        raise StaleError(f"{bug.file} holds its text {found} times, not {bug.times}: {bug.old}")
    target = folder / bug.file
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text.replace(bug.old, bug.new), encoding="utf-8")


def run_tests(folder: Path, files: list[str], *options: str) -> tuple[int, str]:
    """(exit code, first failing test or last line) of pytest on the copy."""
    command = [sys.executable, "-m", "pytest", "-q", "--tb=no", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [*command, *options, *files],
        cwd=ROOT,
        env={**os.environ, "CLGS_TEST_MUTANT": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    lines = [line for line in done.stdout.splitlines() if line.strip()]
    failed = [line.split(" - ")[0] for line in lines if line.startswith(("FAILED", "ERROR"))]
    return done.returncode, (failed or lines[-1:] or [done.stderr.strip()[-200:]])[0]


def caught(bug: Mutation) -> tuple[bool, str]:
    """Whether the stage's tests fail with the bug or crash, and the first that does."""
    with tempfile.TemporaryDirectory(prefix="clgs-mutant-") as name:
        folder = Path(name)
        copy_sources(folder)
        seed(bug, folder)
        options = ["-k", "not cpu"] if bug in GPU_MUTATIONS else []
        code, line = run_tests(folder, SUITES[bug.stage], "-x", *options)
        if -code in CRASHES:  # by a kernel that reads or writes where it must not
            return True, f"crash: {signal.Signals(-code).name}"
        # 1: tests failed; anything else says that they did not run
        return code == 1, line


def stale(bugs: list[Mutation]) -> list[str]:
    """Complaints about bugs that no longer apply to the sources."""
    complaints = []
    for bug in bugs:
        with tempfile.TemporaryDirectory(prefix="clgs-mutant-") as name:
            try:
                seed(bug, Path(name))
            except (StaleError, OSError) as error:
                complaints.append(f"{bug.stage}: {bug.what}: no longer applies: {error}")
    return complaints


def controls(stages: set[str]) -> list[str]:
    """Complaints about the check itself: an unchanged copy passes, a broken one fails."""
    complaints = []
    files = sorted({file for stage in stages for file in SUITES[stage]})
    with tempfile.TemporaryDirectory(prefix="clgs-mutant-") as name:
        folder = Path(name)
        copy_sources(folder)
        code, line = run_tests(folder, files, "-n", str(JOBS), "--dist", "loadfile")
        if code != 0:
            complaints.append(f"the unchanged copy fails: {line}")
        for program in (folder / "kernels_cl").rglob("project*.cl"):
            program.write_text("#error broken\n", encoding="utf-8")
        if run_tests(folder, ["tests/ops/test_project.py"], "-x")[0] != 1:
            complaints.append("a copy that does not compile passes: the copy is not what is tested")
    return complaints


def main() -> int:
    """Run the check; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", default="", help="bugs whose stage or description holds this")
    only = parser.parse_args().only
    every = (*MUTATIONS, *GPU_MUTATIONS)
    bugs = [bug for bug in every if only in f"{bug.stage}: {bug.what}"]
    if not bugs:
        parser.error(f"--only {only}: no bug has this in its stage or description")
    start = time.monotonic()
    complaints = stale(bugs) or controls({bug.stage for bug in bugs})
    for complaint in complaints:
        print(f"error: {complaint}", flush=True)
    if complaints:
        return 1
    number = 0
    with ThreadPoolExecutor(JOBS) as pool:
        for bug, (found, line) in zip(bugs, pool.map(caught, bugs), strict=True):
            number += found
            said = "caught " if found else "MISSED "
            print(f"{said} {bug.stage}: {bug.what}\n        {line}", flush=True)
    print(f"{number} of {len(bugs)} caught in {time.monotonic() - start:.0f} s")
    return int(number < len(bugs))


if __name__ == "__main__":
    sys.exit(main())
