"""The memory of this process: its peak, and how the C library keeps what was freed."""

from __future__ import annotations

import ctypes
import sys

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
"""Parameters of glibc's mallopt, from its malloc.h."""

LARGE = 1 << 20
"""Bytes from which an array goes back to the system as soon as it is freed."""

ARENAS = 2
"""Heaps that all threads share: each heap keeps what was freed in it."""

SETTINGS = {M_TRIM_THRESHOLD: LARGE, M_MMAP_THRESHOLD: LARGE, M_ARENA_MAX: ARENAS}


def peak_memory() -> int | None:
    """The largest resident size of this process so far, in bytes; None if it is unknown."""
    try:
        import resource
    except ImportError:  # Windows has no such module
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def return_freed_memory() -> None:
    """Let large arrays go back to the system when they are freed; glibc would keep many of them.

    Without glibc nothing happens.
    """
    for parameter, value in SETTINGS.items():
        _call("mallopt", parameter, value)


def return_unused_memory() -> None:
    """Let whole pages between arrays in use go back to the system, too.

    This takes a millisecond. Without glibc nothing happens.
    """
    _call("malloc_trim", 0)


def _call(function: str, *values: int) -> None:
    """Call a function of the C library if this is Linux and the library has it."""
    if sys.platform.startswith("linux"):
        library = ctypes.CDLL(None)
        if hasattr(library, function):
            getattr(library, function)(*values)
