"""Turn signals into a question that the training loop asks between steps."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def interruptions() -> Iterator[Callable[[], bool]]:
    """Within the block the first SIGINT or SIGTERM is remembered, and the next acts as before.

    The block receives a function that tells whether one came. State must change as a whole or
    not at all, which an exception in the middle of a step would not respect. Outside of the main
    thread, where Python takes no signals, nothing changes.
    """
    seen: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}

    def remember(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        restore()

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    for number in SIGNALS:
        signal.signal(number, remember)
    try:
        yield lambda: bool(seen)
    finally:
        restore()
