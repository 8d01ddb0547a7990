"""pycolmap in a child process: its result, its end, its failures."""

import os
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import pytest

from clgs.errors import DataError
from clgs.poses.pycolmap_child import CrashError, run_child
from tests.terminal import python

START = """
import os, signal
from clgs.poses.pycolmap_child import quiet_pycolmap
for number in (signal.SIGINT, signal.SIGTERM):  # in the background SIGINT may come ignored
    signal.signal(number, signal.default_int_handler)
try:
    with quiet_pycolmap("a task") as pycolmap:
        print(pycolmap.__name__)
        os.kill(os.getpid(), signal.SIGTERM)
except KeyboardInterrupt:
    print("interrupted")
"""
INTERRUPTED = """
import os, signal
try:
    os.kill(os.getpid(), signal.{name})
    sum(range(1000))
except KeyboardInterrupt as error:
    raise RuntimeError("Cannot import the C++ backend") from error
class logging:
    minloglevel = 0
"""


def test_a_termination_after_the_import_is_an_interrupt():
    pytest.importorskip("pycolmap")
    done = python("-c", START)
    assert (done.stdout, done.stderr) == ("pycolmap\ninterrupted\n", "")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupt_during_the_import_stays_one(tmp_path, name):
    (tmp_path / "pycolmap.py").write_text(INTERRUPTED.format(name=name))
    done = python("-c", START, PYTHONPATH=str(tmp_path))
    assert (done.stdout, done.stderr) == ("interrupted\n", "")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("raise ModuleNotFoundError('no pycolmap')", "a task: pycolmap is missing; pip install"),
        (
            "raise RuntimeError('Cannot import') from ImportError('libgomp.so.1: no such file')",
            "a task: pycolmap cannot be loaded (libgomp.so.1: no such file); install it again",
        ),
    ],
)
def test_a_pycolmap_that_does_not_load_is_named(tmp_path, text, said):
    (tmp_path / "pycolmap.py").write_text(text)
    done = python("-c", START, PYTHONPATH=str(tmp_path))
    assert not done.stdout
    assert f"DataError: {said}" in done.stderr


MODULE = """
import atexit, os, time
from pathlib import Path
atexit.register(time.sleep, 1.0)  # as a process that takes its time to end
def work(arguments, on_stage):
    folder, seconds = arguments
    (Path(folder) / "made").touch()
    (Path(folder).parent / "process").write_text(str(os.getpid()))
    on_stage("made")
    time.sleep(seconds)
    return 42
"""
PARENT = """
from clgs.poses.pycolmap_child import run_child
run_child("{module}", "a test", [{folder!r}, 3600], lambda stage: print(stage, flush=True))
"""
NESTED = """
from clgs.poses.pycolmap_child import run_child
def work(arguments, on_stage):
    return run_child("child_work", "a nested test", arguments, on_stage)
"""
USER = """
from clgs.poses.pycolmap_child import quiet_pycolmap
def work(arguments, on_stage):
    with quiet_pycolmap("a test"):
        pass
"""
KILLED = """
import os, signal
def work(arguments, on_stage):
    os.kill(os.getpid(), signal.SIGKILL)
"""
HANG = 60
"""Seconds after which the clean-up is given up."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "child_work.py").write_text(MODULE)
    (tmp_path / "nested.py").write_text(NESTED)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "new").mkdir()
    return tmp_path / "new"


@pytest.mark.skipif(os.name == "nt", reason="no such signals")
def test_a_pycolmap_that_aborts_is_blamed_not_the_data(folder: Path):
    (folder.parent / "pycolmap.py").write_text("import os; os.abort()")
    (folder.parent / "user.py").write_text(USER)
    said = r"^a test: pycolmap cannot be loaded \(its import ends by signal 6\); install it again$"
    with pytest.raises(DataError, match=said):
        run_child("user", "a test", [], lambda stage: None)


def test_a_result_keeps_what_was_made(folder: Path):
    stages: list[str] = []
    assert run_child("child_work", "a test", [str(folder), 0], stages.append) == 42
    assert stages == ["made"]
    assert [path.name for path in folder.iterdir()] == ["made"]


def test_a_child_leaves_no_file_open(monkeypatch: pytest.MonkeyPatch, capfd):
    monkeypatch.setenv("PYTHONWARNINGS", "always")
    program = "from clgs.poses.pycolmap_child import serve; serve(lambda *_: 42)"
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        child.stdin.write("0\n")
        child.stdin.flush()  # and stays open: the child ends by itself
        assert child.stdout.read() == '["result", 42]\n'
    assert "ResourceWarning" not in capfd.readouterr().err


def ends(process: int) -> bool:
    """Whether a process ends before long; one that ended but was not asked for is a zombie."""
    end = time.monotonic() + HANG
    status = Path(f"/proc/{process}/status")
    while time.monotonic() < end:
        try:
            if "\nState:\tZ" in status.read_text():
                return True
        except OSError:
            return True
        time.sleep(0.05)
    return False


@pytest.mark.parametrize("module", ["child_work", "nested"])
def test_the_process_goes_with_a_killed_parent(folder: Path, module: str):
    command = [sys.executable, "-c", PARENT.format(module=module, folder=str(folder))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout.readline() == "made\n"  # the child has reported its file
        parent.kill()
    assert ends(int((folder.parent / "process").read_text()))


def test_an_interruption_ends_the_children_of_children(folder: Path):
    with pytest.raises(KeyboardInterrupt):
        run_child("nested", "a test", [str(folder), 3600], Mock(side_effect=KeyboardInterrupt))
    assert ends(int((folder.parent / "process").read_text()))


def test_a_nested_result_comes_through(folder: Path):
    assert run_child("nested", "a test", [str(folder), 0], lambda stage: None) == 42


@pytest.mark.skipif(os.name == "nt", reason="no such signals")
def test_a_killed_child_of_a_child_is_no_fault_of_the_data(folder: Path):
    (folder.parent / "child_work.py").write_text(KILLED)
    said = "^a nested test: pycolmap was killed; see if there is enough memory$"
    with pytest.raises(CrashError, match=said):
        run_child("nested", "a test", [], lambda stage: None)
