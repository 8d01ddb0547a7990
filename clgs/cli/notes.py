"""What is good to know while one waits, on the terminal."""

from __future__ import annotations

import logging
import sys

LOGGER = "clgs.notes"
"""As in clgs.opencl.device, which takes long to import."""


class _Shown(logging.Handler):
    """Prints to what standard error is at that moment: above a bar, if there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print one line."""
        print(f"clgs: {record.getMessage()}", file=sys.stderr, flush=True)


def show_notes() -> None:
    """Let notes be seen from now on."""
    logger = logging.getLogger(LOGGER)
    if not logger.handlers:
        logger.addHandler(_Shown())
        logger.setLevel(logging.INFO)
        logger.propagate = False
