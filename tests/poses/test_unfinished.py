"""Unfinished folders are removed if their process is killed, or by the next run."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from clgs.poses.prepare import OWNER, owned, remove_leftovers, removed_if_killed

PROCESS = """
import subprocess, sys
from pathlib import Path
from clgs.poses.prepare import removed_if_killed
folder = Path(sys.argv[1])
folder.mkdir()
with removed_if_killed(folder):
    (folder / "below").mkdir()
    (folder / "below" / "file").touch()
    pipe = subprocess.PIPE
    other = subprocess.Popen([sys.executable, "-c", sys.argv[2], str(folder)], stdout=pipe)
    other.stdout.readline()
    print("made", flush=True)
    sys.stdin.read()
"""
WRITES_ON = """
import os, sys, time
print("writing", flush=True)
end = time.monotonic() + 1.0  # longer than the one who began it lives
while time.monotonic() < end:
    os.makedirs(os.path.join(sys.argv[1], "late"), exist_ok=True)
"""
HANG = 60
"""Seconds after which the clean-up is given up."""


@pytest.mark.parametrize("other", ["", WRITES_ON])
def test_a_killed_process_leaves_nothing(tmp_path: Path, other: str):
    folder = tmp_path / "made"
    command = [sys.executable, "-c", PROCESS, str(folder), other]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "made\n"
        assert (folder / "below" / "file").exists()
        process.kill()
    end = time.monotonic() + HANG
    gone = 0
    while gone < 20 and time.monotonic() < end:  # the other process makes it again for a second
        gone = 0 if folder.exists() else gone + 1
        time.sleep(0.1)
    assert not folder.exists()


def test_otherwise_it_stays(tmp_path: Path):
    with removed_if_killed(tmp_path):
        (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="for a reason"), removed_if_killed(tmp_path):
        raise ValueError("for a reason")
    assert (tmp_path / "file").exists()


def test_what_a_killed_run_left_is_removed(tmp_path: Path):
    left, other = tmp_path / ".data.0123abcd", tmp_path / ".other.0123abcd"
    for folder in (left, other):
        (folder / "work").mkdir(parents=True)
        (folder / "work" / OWNER).touch()
    mine = tmp_path / ".data.my_notes"
    mine.mkdir()
    running = tmp_path / ".data.76543210"
    running.mkdir()
    with owned(running / "work"):
        remove_leftovers(tmp_path / "data")
        assert sorted(tmp_path.iterdir()) == sorted([other, mine, running])
