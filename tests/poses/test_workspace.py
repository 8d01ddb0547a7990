"""A database that another connection holds is waited for: pycolmap itself gives up at once."""

import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from clgs.opencl.device import Device
from clgs.poses import workspace as module
from clgs.poses.workspace import WAITS, Workspace

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")

HOLDER = """
import sqlite3, sys
database = sqlite3.connect(sys.argv[1], isolation_level=None)
database.execute("BEGIN EXCLUSIVE")
print("held", flush=True)
sys.stdin.readline()
database.execute("ROLLBACK")
print("free", flush=True)
sys.stdin.readline()
"""
"""Stays connected at the end: a connection that closes locks the database again for a moment."""


@pytest.fixture
def workspace(tmp_path: Path):
    workspace = Workspace(pycolmap, Device(), tmp_path, tmp_path, [], [], 0, lambda *_: None)
    before, pycolmap.logging.minloglevel = pycolmap.logging.minloglevel, 3
    workspace.open().close()
    yield workspace
    pycolmap.logging.minloglevel = before


@pytest.fixture
def holder(workspace: Workspace):
    """A process that locks the database until it reads a line."""
    command = [sys.executable, "-c", HOLDER, str(workspace.database)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_a_locked_database_is_waited_for(workspace, holder, monkeypatch):
    waited = []

    def free(seconds: float) -> None:
        waited.append(seconds)
        if len(waited) == 2:
            holder.stdin.write("\n")
            holder.stdin.flush()
            assert holder.stdout.readline() == "free\n"

    monkeypatch.setattr(module.time, "sleep", free)
    with workspace.open() as database:
        assert database.num_images() == 0
    assert waited == list(WAITS[:2])


def test_one_that_stays_locked_is_an_error(workspace, holder, monkeypatch):
    monkeypatch.setattr(module.time, "sleep", lambda seconds: None)
    with pytest.raises(RuntimeError, match=module.LOCKED):
        workspace.open()


def test_other_failures_are_raised_at_once(workspace, monkeypatch):
    monkeypatch.setattr(module.time, "sleep", lambda seconds: pytest.fail("waited"))
    with pytest.raises(RuntimeError, match="no such thing"):
        workspace.call(Mock(side_effect=RuntimeError("no such thing")))
