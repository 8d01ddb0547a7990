"""pycolmap: imported only if it is needed, kept quiet, with failures in one line."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

# Pillow must be loaded before pycolmap. In the other order Pillow's PNG writer calls the zlib of
# pycolmap and corrupts the heap (seen with pycolmap 4.2.1 and Pillow 13).
import PIL.Image  # noqa: F401 - only the order of the imports matters

from clgs.errors import DataError

SEEDS = 2**31
"""The number of seeds that pycolmap accepts; larger seeds are reduced modulo this."""

_FATAL_ONLY = 3
"""glog severity: information, warnings and errors are not printed."""


@contextmanager
def quiet_pycolmap(task: str) -> Iterator[Any]:
    """Import pycolmap and keep it quiet; its exceptions become a DataError that names ``task``.

    Raises:
        DataError: pycolmap is not installed, or fails.
    """
    pycolmap = _load(task)
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = _FATAL_ONLY
    try:
        yield pycolmap
    except DataError:
        raise
    # C++ code and pybind11 raise many types; every one of them means that the task failed.
    except Exception as error:
        raise DataError(f"{task}: {' '.join(str(error).split())[-200:]}") from error
    finally:
        pycolmap.logging.minloglevel = before


def _load(task: str) -> Any:
    try:
        with _handlers_kept():
            import pycolmap
    except ModuleNotFoundError as error:
        raise DataError(
            f"{task}: pycolmap is missing; pip install pycolmap, or use a machine that it has a "
            "wheel for and copy the result"
        ) from error
    # pycolmap turns an ImportError of its C++ part into a RuntimeError.
    except (ImportError, RuntimeError) as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise DataError(
            f"{task}: pycolmap cannot be loaded ({reason}); install it again"
        ) from error
    return pycolmap


@contextmanager
def _handlers_kept() -> Iterator[None]:
    """Delay signals within the block; after it the former handlers receive them.

    pycolmap's C++ part installs handlers that end the process with a native stack trace. An
    exception that a handler raises during its import would come out as a different one.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    found = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    before = {number: handler for number, handler in found.items() if handler is not None}
    seen: list[int] = []

    def remember(number: int, frame: FrameType | None) -> None:
        seen.append(number)

    for number in before:
        signal.signal(number, remember)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for arrived in seen:
        signal.raise_signal(arrived)
