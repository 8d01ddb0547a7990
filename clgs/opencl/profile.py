"""Wall time by stage."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median


class Profile:
    """Collects seconds by name while ``enabled``; costs nothing otherwise."""

    def __init__(self) -> None:
        self.enabled = False
        self.seconds: dict[str, list[float]] = {}

    @contextmanager
    def measure(self, name: str) -> Iterator[None]:
        """Record the wall time of the enclosed block under ``name``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds.setdefault(name, []).append(time.perf_counter() - start)

    def clear(self) -> None:
        """Forget all records."""
        self.seconds.clear()

    def rows(self) -> list[tuple[str, int, float, float]]:
        """(name, calls, median milliseconds, total seconds), in order of first appearance."""
        return [
            (name, len(values), 1e3 * median(values), sum(values))
            for name, values in self.seconds.items()
        ]
