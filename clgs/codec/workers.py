"""Threads for the C functions of the codec, which release the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

from clgs.errors import UsageError
from clgs.shapes import check_integer


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


def processors() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
