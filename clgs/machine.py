"""This machine and this process: processor, system and versions; memory, threads and signals.

Memory is what is free, the peak of this process, and how the C library keeps what was freed.
Threads are for C functions that release the interpreter's lock. Signals that ask the process to end
are remembered until it is ready to. Pipes that a library leaves open are closed.
"""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from types import FrameType, GeneratorType
from typing import Any

from clgs import __version__
from clgs.arguments import check_integer
from clgs.errors import UsageError

LIBRARIES = ("numpy", "pyopencl")


def host_facts() -> dict[str, object]:
    """The processor's name, the operating system, and versions; no host names and no times."""
    versions = {name: metadata.version(name) for name in LIBRARIES}
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "processor": models[0] if models else platform.processor(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "versions": {"clgs": __version__, "python": platform.python_version(), **versions},
    }


def available_memory() -> int | None:
    """Bytes that programs can have without swapping; None if the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
    except OSError:
        return None
    sizes = (line.split() for line in lines if line.startswith("MemAvailable:"))
    return next((int(words[1]) << 10 for words in sizes), None)


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


@contextmanager
def workers(threads: int | None = None) -> Iterator[ThreadPoolExecutor]:
    """A pool of ``threads``, by default one per processor that this process may use.

    On an error, tasks that have not begun are dropped.

    Raises:
        TypeError: ``threads`` is no integer.
        UsageError: ``threads`` is less than one.
    """
    if threads is not None and check_integer("threads", threads) < 1:
        raise UsageError(f"threads: {threads}; at least 1 is needed")
    pool = ThreadPoolExecutor(threads or processors(), thread_name_prefix="codec")
    try:
        yield pool
    except BaseException:
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


@contextmanager
def repeatedly(action: Callable[[], object], seconds: float) -> Iterator[None]:
    """Call ``action`` in a thread of its own within the block, ``seconds`` apart."""
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(seconds):
            action()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def processors() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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


@contextmanager
def ffmpeg_closed(generator: GeneratorType[Any, Any, Any]) -> Iterator[None]:
    """After the block, close a generator of imageio-ffmpeg and the pipes that it leaves open."""
    frame = generator.gi_frame
    try:
        yield
    finally:
        generator.close()
        found = frame.f_locals if frame else {}
        process = found.get("process") or found.get("p")
        for pipe in (process.stdin, process.stdout, process.stderr) if process else ():
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
