"""The process of structure from motion ends with its parent, at once, and its crash is an error."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from clgs.errors import DataError
from clgs.poses import reconstruct
from clgs.poses.known import Known
from tests.data.folders import write_noise
from tests.terminal import as_from_a_terminal

PYCOLMAP = """
import os, signal, time
from types import SimpleNamespace
class logging:
    minloglevel = 0
CameraMode = SimpleNamespace(SINGLE=0)
Device = SimpleNamespace(cpu=0)
def set_random_seed(seed):
    print("a library says something")
class Database:
    open = staticmethod(lambda path: SimpleNamespace(close=lambda: None))
ImageReaderOptions = SimpleNamespace
def import_images(*arguments, **keywords):
    {act}
"""
DEAF = """
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT, signal.SIGTERM])
    open("deaf", "x").close()
    time.sleep(600)
"""
"""Acts as native code that ignores signals."""

HANG = 120
"""Seconds after which a process that does not end is given up."""

pytestmark = pytest.mark.skipif(os.name == "nt", reason="no such signals")


@pytest.fixture
def start(tmp_path):
    """Start ``clgs prepare`` with a pycolmap that does something else; it ends with the test."""
    started: list[subprocess.Popen[str]] = []
    write_noise(tmp_path / "photos")
    (tmp_path / "data").mkdir()

    def start_with(act):
        (tmp_path / "pycolmap.py").write_text(PYCOLMAP.format(act=act.strip()))
        module = ["-m", "clgs", "prepare", "photos", "-o", "data/new"]
        process = subprocess.Popen(
            [sys.executable, *module],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=as_from_a_terminal,
        )
        started.append(process)
        return process

    yield start_with
    for process in started:
        process.kill()
        process.communicate(timeout=HANG)


def until_deaf(process, folder):
    """Wait for the file that pycolmap makes when it is called; what is printed may come mixed."""
    end = time.monotonic() + HANG
    while not (folder / "deaf").exists():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < end, "pycolmap was never called"
        time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_does_not_wait_for_native_code(start, tmp_path: Path, name: str):
    process = start(DEAF)
    until_deaf(process, tmp_path)
    process.send_signal(getattr(signal, name))
    out, err = process.communicate(timeout=HANG)  # until no process is left that could write
    assert (out, err.splitlines()[-1]) == ("", "clgs: interrupted")
    assert process.returncode == 130
    assert list((tmp_path / "data").iterdir()) == []


@pytest.mark.slow
def test_a_killed_parent_leaves_neither_process_nor_folder(start, tmp_path: Path):
    process = start(DEAF)
    until_deaf(process, tmp_path)
    process.kill()
    assert process.communicate(timeout=HANG)[0] == ""
    end = time.monotonic() + HANG
    while any((tmp_path / "data").iterdir()) and time.monotonic() < end:
        time.sleep(0.05)  # the guard is yet another process
    assert list((tmp_path / "data").iterdir()) == []


@pytest.mark.slow
def test_a_crash_is_one_line(start, tmp_path: Path):
    process = start("os._exit(77)")
    out, err = process.communicate(timeout=HANG)
    assert (out, process.returncode) == ("", 3)
    said = "clgs: error: structure from motion: pycolmap crashed (exit code 77); try other photos"
    assert err.splitlines()[-1] == said
    assert list((tmp_path / "data").iterdir()) == []


@pytest.mark.slow
def test_a_failure_keeps_its_words(start):
    process = start("raise ValueError('no SIFT today')")
    _, err = process.communicate(timeout=HANG)
    assert err.splitlines()[-1] == "clgs: error: structure from motion: no SIFT today"
    assert process.returncode == 3


def test_a_crash_on_a_full_disk_asks_for_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    crash = DataError("structure from motion: pycolmap crashed (exit code -6); try other photos")
    monkeypatch.setattr(reconstruct, "run_child", Mock(side_effect=crash))
    arguments = tmp_path, 0, False, 0, None, lambda *_: None, Known(), False, tmp_path
    with pytest.raises(DataError, match="crashed"):
        reconstruct.reconstruct(*arguments)
    monkeypatch.setattr(reconstruct.shutil, "disk_usage", lambda path: SimpleNamespace(free=4096))
    with pytest.raises(OSError, match="No space left"):
        reconstruct.reconstruct(*arguments)
