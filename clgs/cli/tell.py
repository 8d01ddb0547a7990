"""Lines on standard error: notes, warnings and errors; results go to standard output."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager

LOGGER = "clgs.notes"
"""The name that clgs.opencl.device gives its logger; that module takes long to import."""


def tell(line: str) -> None:
    """Print one line at once, and in one piece.

    ``print`` writes the end of a line by itself if Python does not buffer (PYTHONUNBUFFERED), and
    the output of another process may come before it.
    """
    if sys.stderr is not None:  # closed by the caller: `clgs info scene.clgs 2>&-`
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()


def counted(number: int, thing: str) -> str:
    """A number of things in a sentence, such as "1 view" and "2 views"."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


class _Notes(logging.Handler):
    """Prints to what standard error is at that moment: above a bar, if there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print one line."""
        tell(f"clgs: {record.getMessage()}")


def show_notes() -> None:
    """Print the notes of the logger LOGGER from now on."""
    logger = logging.getLogger(LOGGER)
    if not logger.handlers:
        logger.addHandler(_Notes())
        logger.setLevel(logging.INFO)
        logger.propagate = False


@contextmanager
def warnings_once() -> Iterator[None]:
    """Within the block each warning is shown once, although several stages give it."""
    shown: set[str] = set()

    def is_new(record: logging.LogRecord) -> bool:
        message = record.getMessage()
        known = message in shown
        shown.add(message)
        return not known

    handlers = logging.getLogger().handlers[:]
    for handler in handlers:
        handler.addFilter(is_new)
    try:
        yield
    finally:
        for handler in handlers:
            handler.removeFilter(is_new)
