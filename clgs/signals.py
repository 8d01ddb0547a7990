"""Signals that ask a process to end, remembered until it is ready to."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""The signals that end a training run as soon as the current step is done."""


@contextmanager
def interruptions() -> Iterator[Callable[[], bool]]:
    """Remember the first SIGINT or SIGTERM within the block; the next one acts as before.

    One that is ignored, as SIGINT is in a background job, stays so.

    The block receives a function that says whether one came. An exception in the middle of a
    training step would leave half of the state changed. Between two steps, where the function is
    called, the state is whole. Python handles signals in the main thread alone; in other threads
    the function always returns False.
    """
    seen: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    before = {number: old for number, old in before.items() if old is not signal.SIG_IGN}

    def remember(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        restore()

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    for number in before:
        signal.signal(number, remember)
    try:
        yield lambda: bool(seen)
    finally:
        restore()
