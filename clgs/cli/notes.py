"""What is told while one waits, on the terminal: notes, and each warning once."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from clgs.cli.tell import tell

LOGGER = "clgs.notes"
"""As in clgs.opencl.device, which takes long to import."""


class _Shown(logging.Handler):
    """Prints to what standard error is at that moment: above a bar, if there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print one line."""
        tell(f"clgs: {record.getMessage()}")


def show_notes() -> None:
    """Let notes be seen from now on."""
    logger = logging.getLogger(LOGGER)
    if not logger.handlers:
        logger.addHandler(_Shown())
        logger.setLevel(logging.INFO)
        logger.propagate = False


@contextmanager
def warnings_once() -> Iterator[None]:
    """Let each warning be shown once, although several commands in here give it."""
    told: set[str] = set()

    def is_new(record: logging.LogRecord) -> bool:
        message = record.getMessage()
        known = message in told
        told.add(message)
        return not known

    handlers = logging.getLogger().handlers[:]
    for handler in handlers:
        handler.addFilter(is_new)
    try:
        yield
    finally:
        for handler in handlers:
            handler.removeFilter(is_new)
