"""Programs that a test starts, and those that it interrupts."""

import os
import signal
import subprocess
import sys
from pathlib import Path


def python(
    *words: object, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """What a Python wrote that was called with these words, and these variables set."""
    command, more = [sys.executable, *map(str, words)], os.environ | environment
    return subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=cwd, env=more)


def as_from_a_terminal() -> None:
    """A ``preexec_fn``. A shell's background job starts with SIGINT ignored, nohup's SIGHUP."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
