"""pycolmap, imported only when it is needed, kept quiet, its failures in one line."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

# Pillow must be loaded before pycolmap: the other way round its PNG writer calls pycolmap's zlib
# and corrupts the heap (seen with pycolmap 4.2.1 and Pillow 13).
import PIL.Image  # noqa: F401 - imported for the order alone

from clgs.errors import DataError

SEEDS = 2**31
"""Seeds that pycolmap takes: larger ones are reduced modulo this."""

_FATAL_ONLY = 3
"""glog severity: information, warnings and errors are not printed."""


@contextmanager
def quiet_pycolmap(task: str) -> Iterator[Any]:
    """The pycolmap module, printing nothing; its exceptions become a DataError naming ``task``.

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
    # pycolmap throws whatever its C++ code or pybind11 chooses; all of it means a failed task.
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
    # It turns an ImportError of its C++ part into a RuntimeError.
    except (ImportError, RuntimeError) as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise DataError(
            f"{task}: pycolmap cannot be loaded ({reason}); install it again"
        ) from error
    return pycolmap


@contextmanager
def _handlers_kept() -> Iterator[None]:
    """Within the block signals wait; after it they act as they would have before it.

    pycolmap's C++ part sets handlers of its own, which end the process with a native stack trace,
    and an exception in the middle of its import comes out as another one.
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
