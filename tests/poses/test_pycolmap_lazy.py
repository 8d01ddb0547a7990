"""pycolmap's import leaves the handlers of signals alone, and its failures are one line."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

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


def run(folder=None):
    """The printed lines and the errors of a process that imports pycolmap, from ``folder``."""
    environment = dict(os.environ)
    if folder is not None:
        environment["PYTHONPATH"] = str(folder)
    done = subprocess.run(
        [sys.executable, "-c", START], capture_output=True, text=True, check=False, env=environment
    )
    return done.stdout.split(), done.stderr


def test_a_termination_after_the_import_is_an_interrupt():
    pytest.importorskip("pycolmap")
    assert run() == (["pycolmap", "interrupted"], "")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupt_during_the_import_stays_one(tmp_path, name):
    (tmp_path / "pycolmap.py").write_text(INTERRUPTED.format(name=name))
    assert run(tmp_path) == (["interrupted"], "")


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
    printed, errors = run(tmp_path)
    assert not printed
    assert f"DataError: {said}" in errors
