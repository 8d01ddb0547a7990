"""What is said beside the result of a command: lines on standard error."""

from __future__ import annotations

import sys


def tell(line: str) -> None:
    """Print one line at once, and in one piece.

    ``print`` writes the end of a line by itself if Python does not buffer (PYTHONUNBUFFERED), and
    what another process says may come before it.
    """
    if sys.stderr is not None:  # closed by the caller: `clgs info scene.clgs 2>&-`
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()
