"""The process beside: what it made outlives its success, and goes if its parent is killed."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from clgs.data.sfm.child import run_child

MODULE = """
import time
from pathlib import Path
from clgs.data.sfm.child import serve
def work(arguments, on_stage):
    folder, seconds = arguments
    (Path(folder) / "made").touch()
    on_stage("made")
    time.sleep(seconds)
    return 42
def main():
    serve(work, scratch=lambda arguments: arguments[0])
    time.sleep(1.0)  # as a process that takes its time to end
"""
PARENT = """
from clgs.data.sfm.child import run_child
run_child("work_beside", "a test", [{folder!r}, 3600], lambda told: print(told, flush=True))
"""
HANG = 60
"""Seconds after which the clean-up is given up."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "work_beside.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "new").mkdir()
    return tmp_path / "new"


def test_a_result_keeps_what_was_made(folder: Path):
    told: list[str] = []
    assert run_child("work_beside", "a test", [str(folder), 0], told.append) == 42
    assert told == ["made"]
    assert [path.name for path in folder.iterdir()] == ["made"]


def test_what_was_made_goes_with_a_killed_parent(folder: Path):
    command = [sys.executable, "-c", PARENT.format(folder=str(folder))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "made\n"
        parent.kill()
    end = time.monotonic() + HANG
    while folder.exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert not folder.exists()
