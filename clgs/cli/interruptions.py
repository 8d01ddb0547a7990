"""Ctrl-C, SIGTERM and a terminal that closes: each raises KeyboardInterrupt, but in no import."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
import time
from types import FrameType, TracebackType
from typing import Any

LATER = 0.02
"""Seconds after which an interruption that came in the middle of an import comes again."""

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
"""SIGHUP is not everywhere."""

_IMPORT = "<frozen importlib"


class Interruptions:
    """Within the block signals raise KeyboardInterrupt in the main thread, which alone takes them.

    A process that ends in the middle of native code, which has threads and handlers of its own,
    may leave with a native stack trace instead of one line. In the middle of an import Python
    loses an interruption that meets one of its callbacks, and after one that meets ``exec`` (each
    dataclass has one) ``python -m`` dies by the signal although it was caught. So an import ends
    first, unless a second signal comes. Signals that are ignored, as those of a background job,
    or that the caller handles, stay so; only SIGTERM is ours in any case.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._ignored: list[int] = []
        self._base: FrameType | None = None
        self._waiting = 0
        self._repeated = False
        self._lock = _thread.allocate_lock()

    def __enter__(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            return
        self._base = sys._getframe(1)
        for name in filter(lambda name: hasattr(signal, name), _NAMES):
            number = getattr(signal, name)
            handler = signal.getsignal(number)
            free = {
                "SIGINT": handler is signal.default_int_handler,
                "SIGHUP": handler is signal.SIG_DFL,
            }
            if free.get(name, True):
                self._before[number] = handler
                signal.signal(number, self._raise)
            elif handler is signal.SIG_IGN:
                self._ignored.append(number)
        self._mask("SIG_BLOCK")  # PoCL's compiler would take them, and builds would fail

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        try:
            with self._lock:  # no signal is sent from here on
                waiting, self._waiting = self._waiting, 0
        finally:
            for number, handler in self._before.items():
                signal.signal(number, handler or signal.SIG_DFL)
            self._mask("SIG_UNBLOCK")
            self._base = None
        if waiting and kind is None:
            raise KeyboardInterrupt

    def _mask(self, how: str) -> None:
        if hasattr(signal, "pthread_sigmask"):  # not on Windows
            signal.pthread_sigmask(getattr(signal, how), self._ignored)

    def _raise(self, number: int, frame: FrameType | None) -> None:
        second = self._waiting and not self._repeated
        self._repeated = False
        if second or not self._imports(frame):
            self._waiting = 0
            raise KeyboardInterrupt
        self._waiting = number
        try:
            _thread.start_new_thread(self._repeat, ())  # threading's start may hold a lock here
        except RuntimeError:  # too many threads
            self._waiting = 0
            raise KeyboardInterrupt from None

    def _repeat(self) -> None:
        time.sleep(LATER)
        with self._lock:
            if not self._waiting:
                return
            self._repeated = True
            if hasattr(signal, "pthread_kill"):  # so that the main thread wakes if it waits
                signal.pthread_kill(threading.main_thread().ident or 0, self._waiting)
            else:  # Windows
                signal.raise_signal(self._waiting)

    def _imports(self, frame: FrameType | None) -> bool:
        """Whether an import that began within the block is under way."""
        while frame is not None and frame is not self._base:
            if frame.f_code.co_filename.startswith(_IMPORT):
                return True
            frame = frame.f_back
        return False
