"""A process beside that removes a folder if this one is killed, which could not do it itself."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_GUARD = """
import shutil, sys, time
if not sys.stdin.buffer.read():
    for _ in range(50):  # children of the killed one may write for a moment more
        shutil.rmtree(sys.argv[1], ignore_errors=True)
        time.sleep(0.1)
"""


@contextmanager
def removed_if_killed(folder: Path) -> Iterator[None]:
    """Within the block ``folder`` goes with all that it holds if this process is killed."""
    with subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", _GUARD, str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # what ends all processes of a terminal passes it over
    ) as guard:
        try:
            yield
        finally:
            with suppress(BrokenPipeError):
                guard.communicate(b"done")
