"""The suite is whole: every family has tests, and there are enough cases."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from tests.stress.families import FAMILIES

ROOT = Path(__file__).resolve().parents[2]
MARK = re.compile(r'@pytest\.mark\.family\("(N\d\d)"\)')
CASES = 2000


def test_names_are_consecutive():
    assert list(FAMILIES) == [f"N{number:02d}" for number in range(1, 37)]


def test_every_family_has_tests():
    texts = [path.read_text() for path in (ROOT / "tests").rglob("test_*.py")]
    found = {name for text in texts for name in MARK.findall(text)}
    assert found == set(FAMILIES)


def test_there_are_enough_cases():
    """Without those of -m slow."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--collect-only", "-qq", "-m", "family and not slow"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    counts = [int(line.rsplit(": ", 1)[1]) for line in done.stdout.splitlines() if ": " in line]
    assert sum(counts) >= CASES
