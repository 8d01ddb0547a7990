#!/usr/bin/env python3
"""Do the tests notice bugs? Seeds them one at a time and runs the tests of the stage.

    scripts/checks/mutation_check.py [STAGE ...] [--per-stage N] [--seed N] [--minutes N]

``mutants.py`` makes the bugs. Of every stage N are drawn; a header counts for one of the stages
that include it, and the tests of all of them judge it. Each mutant is a copy of the kernels (and an
op) of its own, and the tests must fail on it. A mutant that changes one form of the kernels alone
is judged by the tests of that form. First the same tests must pass on an unchanged copy, and fail
on one that does not compile.

A mutant that does not compile, or whose compiled programs are all known from the original, is no
mutant; nor is one in EQUIVALENT. Exit code 1 if fewer than LEAST_CAUGHT of the others are caught,
or if a first condition does not hold. The survivors are named: each asks for a test, or for a line
in EQUIVALENT that says why nobody can notice it.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from mutants import ROOT, STAGES, Mutant, all_mutants

JOBS = min(os.cpu_count() or 1, 8)
CRASHES = (signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE)
LEAST_CAUGHT = 0.85
SECONDS = 1800.0
"""After this the tests of a mutant are stopped: its loop may not end."""

KERNELS = Path(os.environ.get("CLGS_TEST_KERNELS", ROOT / "build" / "test_kernels"))
"""Where the tests keep what they have built."""

STRESS = {
    "project": ("geometry", "tiers"), "tiles": ("order",), "sort": ("order",),
    "blend": ("blending", "counts", "poison", "tiers"), "scan": ("counts",), "adam": ("sums",),
    "loss": ("sums",), "rate": ("sums",), "neural": ("poison",), "mlp": ("tiers",),
}  # fmt: skip
"""Files of tests/stress that judge a stage in addition to its own tests."""

EQUIVALENT: dict[str, str] = {}
"""Why nobody can notice a mutant, by its number or by its rule."""


def suite(stage: str) -> list[str]:
    """The tests of a stage."""
    stress = [f"tests/stress/test_{theme}.py" for theme in STRESS.get(stage, ())]
    room, _, name = STAGES[stage].rpartition("/")
    growth = ("grow", "prune") if stage == "growth" else ()
    density = [f"tests/train/step/test_{one}.py" for one in growth]
    return [f"tests/ops/{room}/test_{name}.py", *stress, *density]


def drawn(mutants: Iterable[Mutant], stages: list[str], count: int, seed: int) -> list[Mutant]:
    """Up to ``count`` mutants of every stage, of all rules in turn.

    The same text and seed give the same ones, and a change of some lines changes few of them.
    """
    by_stage: dict[str, list[Mutant]] = {stage: [] for stage in stages}
    for mutant in mutants:
        stage = mutant.stages[int(mutant.number, 16) % len(mutant.stages)]
        if stage in by_stage and not {mutant.number, mutant.rule} & set(EQUIVALENT):
            by_stage[stage].append(mutant)
    chosen = []
    for own in by_stage.values():
        own.sort(key=lambda one: random.Random(f"{seed} {one.number}").random())
        before = Counter[str]()
        ranks = {}
        for mutant in own:
            ranks[mutant.number] = before[mutant.rule]
            before[mutant.rule] += 1
        chosen += sorted(own, key=lambda one: ranks[one.number])[:count]
    return chosen


def run_tests(folder: Path, files: Iterable[str], *options: str) -> tuple[int, str]:
    """(exit code, first failing test or last line) of pytest on the copy in ``folder``."""
    command = [sys.executable, "-m", "pytest", "-q", "--tb=short", "-p", "no:cacheprovider"]
    command += ["-m", "not release"]  # slow tests look, too
    variables = {"CLGS_TEST_MUTANT": str(folder), "CLGS_TEST_KERNELS": str(folder / "built")}
    try:
        done = subprocess.run(
            [*command, *options, *files],
            cwd=ROOT,
            env={**os.environ, **variables},
            capture_output=True,
            text=True,
            check=False,
            timeout=SECONDS,
        )
    except subprocess.TimeoutExpired:
        return 1, "the tests do not end"
    if -done.returncode in CRASHES:  # a kernel reads or writes where it must not
        return 1, f"crash: {signal.Signals(-done.returncode).name}"
    if "BUILD_PROGRAM_FAILURE" in done.stdout:
        return 1, "does not compile"
    lines = [line for line in done.stdout.splitlines() if line.strip()]
    failed = [line.split(" - ")[0] for line in lines if line.startswith(("FAILED", "ERROR"))]
    return done.returncode, (failed or lines[-1:] or [done.stderr.strip()[-200:]])[0]


def judge(mutant: Mutant) -> tuple[str, str]:
    """The verdict (caught, SURVIVED or no mutant), and the test that fails or the reason."""
    with tempfile.TemporaryDirectory(prefix="clgs-mutant-") as name:
        folder = copy_of_sources(Path(name))
        target = folder / mutant.file
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(mutant.text, encoding="utf-8")
        files = dict.fromkeys(file for stage in mutant.stages for file in suite(stage))
        other = {"cpu": "gpu", "gpu": "cpu"}.get(mutant.form)
        options = ["-k", f"not {other}"] if other else []
        code, line = run_tests(folder, files, "-x", *options)
        if line == "does not compile":
            return "no mutant", line
        if code == 0 and mutant.file.startswith("kernels_cl/") and not new_programs(folder):
            return "no mutant", "the compiled programs are the same"
        # 1: tests failed; anything else but 0 says that they did not run
        return ("caught" if code == 1 else "SURVIVED"), line


def copy_of_sources(folder: Path) -> Path:
    """Fill ``folder`` with the kernels, and with what the tests have built of the original."""
    shutil.copytree(ROOT / "kernels_cl", folder / "kernels_cl")
    (folder / "clgs").mkdir()
    if KERNELS.is_dir():
        shutil.copytree(KERNELS, folder / "built", copy_function=os.link)
    return folder


def new_programs(folder: Path) -> bool:
    """Whether the tests compiled a program that the original does not compile to."""
    known = {path.read_bytes() for path in KERNELS.glob("*/*/program.bc")}
    return any(path.read_bytes() not in known for path in folder.glob("built/*/*/program.bc"))


def controls(stages: Iterable[str]) -> list[str]:
    """Complaints about the check itself: an unchanged copy passes, a broken one fails."""
    complaints = []
    files = sorted({file for stage in stages for file in suite(stage)})
    with tempfile.TemporaryDirectory(prefix="clgs-mutant-") as name:
        folder = copy_of_sources(Path(name))
        code, line = run_tests(folder, files, "-n", str(JOBS), "--dist", "loadfile")
        if code != 0:
            complaints.append(f"the unchanged copy fails: {line}")
        for path in folder.rglob("built/**/*.*"):  # what an original is known by
            kept = KERNELS / path.relative_to(folder / "built")
            if path.is_file() and not kept.exists():
                kept.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, kept)
        for program in (folder / "kernels_cl").rglob("project*.cl"):
            program.write_text("#error broken\n", encoding="utf-8")
        if run_tests(folder, ["tests/ops/test_project.py"], "-x")[0] != 1:
            complaints.append("a copy that does not compile passes: the copy is not what is tested")
    return complaints


def main() -> int:
    """Run the check; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    add = parser.add_argument
    add("stages", nargs="*", metavar="STAGE", help=f"of {', '.join(STAGES)}; default: all")
    add("--per-stage", type=int, default=6, metavar="N", help="mutants of each; default: 6")
    add("--seed", type=int, default=0, help="of the choice; default: 0")
    add("--minutes", type=float, default=1e9, help="no mutant is begun after this time")
    args = parser.parse_args()
    if wrong := set(args.stages) - set(STAGES):
        parser.error(f"no stage {', '.join(sorted(wrong))}; there are {', '.join(STAGES)}")
    stages, start = args.stages or list(STAGES), time.monotonic()
    every = all_mutants()
    mutants = drawn(every, stages, args.per_stage, args.seed)
    print(f"{len(mutants)} of {len(every)} mutants", flush=True)
    complaints = controls(stages)
    for complaint in complaints:
        print(f"error: {complaint}", flush=True)
    if complaints:
        return 1

    def judged(mutant: Mutant) -> tuple[str, str]:
        late = time.monotonic() - start > 60 * args.minutes
        return ("left out", "no time is left") if late else judge(mutant)

    counts = Counter[str]()
    with ThreadPoolExecutor(JOBS) as pool:
        waiting = {pool.submit(judged, mutant): mutant for mutant in mutants}
        for future in as_completed(waiting):
            mutant, (verdict, line) = waiting[future], future.result()
            counts[verdict] += 1
            if verdict == "left out":
                continue
            print(f"{verdict:9} {mutant.number} {mutant.file}, {mutant.rule}: {line}")
            print(f"          {mutant.what}", flush=True)
    total = counts["caught"] + counts["SURVIVED"]
    share = counts["caught"] / total if total else 0.0
    print(
        f"{counts['caught']} of {total} caught ({share:.0%}, at least {LEAST_CAUGHT:.0%} must be), "
        f"{counts['no mutant']} no mutants, {counts['left out']} left out, "
        f"{time.monotonic() - start:.0f} s"
    )
    return int(share < LEAST_CAUGHT)


if __name__ == "__main__":
    sys.exit(main())
