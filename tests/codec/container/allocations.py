"""Allocations that fail, one after the other: python -m tests.codec.container.allocations NAME."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from clgs import _codec

MOST = 50
"""More allocations than any function of the binding makes."""


def calls() -> dict[str, tuple]:
    """Functions of the binding with arguments for which they succeed."""
    value = np.arange(12, dtype=np.int32).reshape(4, 3)
    points = np.array([[0, 0, 0], [1, 2, 3]], np.int32)
    word = np.zeros(20, np.uint32)
    matrix = np.array([[4, 5]], np.uint32)
    return {
        "octree_encode": (points, 0, 0, 0),
        "octree_decode": (_codec.octree_encode(points, 0, 0, 0), points.copy()),
        "runlength_encode": (value, 3),
        "runlength_decode": (_codec.runlength_encode(value, 3), value.copy(), 3),
        "paper_encode": (value, 3),
        "paper_decode": (_codec.paper_encode(value, 3), value.copy(), 3),
        "planes_encode": (word,),
        "planes_decode": (_codec.planes_encode(word), word.copy()),
        "weights_encode": (word, matrix),
        "weights_decode": (_codec.weights_encode(word, matrix), word.copy(), matrix),
    }


def fail_each(function: Callable[..., object], arguments: tuple) -> int:
    """Call with the n-th allocation failing, for all n until the call succeeds; that n.

    Python reports a TypeError instead of a MemoryError if it was NumPy that could not describe its
    buffer.
    """
    import _testcapi

    function(*arguments)
    for n in range(MOST):
        failed = False
        _testcapi.set_nomemory(n, n + 1)
        try:
            function(*arguments)
        except (MemoryError, TypeError):
            failed = True
        finally:
            _testcapi.remove_mem_hooks()
        if not failed:
            break
    function(*arguments)
    return n


if __name__ == "__main__":
    print(fail_each(getattr(_codec, sys.argv[1]), calls()[sys.argv[1]]))
