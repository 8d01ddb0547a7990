"""Hidden folders of unfinished runs: removed if their run is killed, or by a later run."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clgs.files import STEM_KEPT

OWNER = "owner"
"""A file in the folder work/ of an unfinished data set; the running process holds a lock on it."""

_GUARD = """
import shutil, sys, time
if not sys.stdin.buffer.read():
    for _ in range(50):  # children of the killed process may write for a moment more
        shutil.rmtree(sys.argv[1], ignore_errors=True)
        time.sleep(0.1)
"""


@contextmanager
def removed_if_killed(folder: Path) -> Iterator[None]:
    """Remove ``folder`` and all that it holds if this process is killed within the block.

    A killed process cannot do that, so another process waits for its end.
    """
    with subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", _GUARD, str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # so that it survives what ends all processes of a terminal
    ) as guard:
        try:
            yield
        finally:
            with suppress(BrokenPipeError):
                guard.communicate(b"done")


@contextmanager
def owned(work: Path) -> Iterator[None]:
    """Make the folder ``work`` and show other processes that it is in use within the block."""
    work.mkdir()
    with (work / OWNER).open("wb") as file:
        if os.name != "nt":
            import fcntl

            with suppress(OSError):  # a file system without locks
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield


def remove_leftovers(output: Path) -> None:
    """Remove the hidden folders that killed runs with the same ``output`` left next to it."""
    if os.name == "nt" or not output.parent.is_dir():
        return
    import fcntl

    name = rf"\.{re.escape(output.stem[:STEM_KEPT])}\.[0-9a-f]{{8}}{re.escape(output.suffix)}"
    for folder in output.parent.iterdir():
        if not re.fullmatch(name, folder.name):
            continue
        try:
            with (folder / "work" / OWNER).open("rb") as file:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:  # there is no such file, or a running process holds the lock
            continue
        shutil.rmtree(folder, ignore_errors=True)
