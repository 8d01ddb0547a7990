"""Kill a training run again and again: ``python scripts/checks/kill_check.py DATA --kills 200``.

Every process is killed (SIGKILL) at a random instant of its life, and the next one resumes. A run
that comes to its end must have the file of one that nobody disturbed; then a new one begins.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory


def main() -> int:
    """Exit code 1 if a run failed or ended in another file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", help="of `clgs train`")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--interval", type=int, default=10, help="steps between checkpoints")
    parser.add_argument("--seed", type=int, default=0, help="of the instants")
    args = parser.parse_args()
    with TemporaryDirectory() as folder:
        return check(args, Path(folder))


def check(args: argparse.Namespace, folder: Path) -> int:
    """Kill, resume and compare in ``folder``."""
    start = time.monotonic()
    if begin(args, folder / "whole").wait():
        return 1
    life, wanted = time.monotonic() - start, digest(folder / "whole")
    draw, kills, ends, run = random.Random(args.seed), 0, 0, folder / "killed"
    while True:
        process = begin(args, run)
        try:
            code = process.wait(draw.uniform(0, life) if kills < args.kills else None)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
            kills += code < 0
            continue
        if code or digest(run) != wanted:
            print(f"after {kills} kills: exit code {code}, another file or none", file=sys.stderr)
            return 1
        ends += 1
        if kills >= args.kills:
            break
        shutil.rmtree(run)
    print(f"{kills} kills, {ends} runs that ended in the file of the undisturbed one")
    return 0


def begin(args: argparse.Namespace, run: Path) -> subprocess.Popen[bytes]:
    """A process that trains in the folder ``run``, or goes on there."""
    words = ["train", args.data, "-o", str(run), "--steps", str(args.steps), "--resume"]
    words += ["--checkpoint-interval", str(args.interval)]
    program = Path(sys.executable).with_name("clgs")
    return subprocess.Popen([program, *words], stdout=subprocess.DEVNULL)


def digest(run: Path) -> str:
    """SHA-256 of the run's file."""
    return hashlib.sha256((run / "scene.clgs").read_bytes()).hexdigest()


if __name__ == "__main__":
    sys.exit(main())
