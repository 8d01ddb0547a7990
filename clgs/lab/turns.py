"""Times of tasks that take turns, so that none has the better minute."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TypeVar

Key = TypeVar("Key")


def take_turns(
    tasks: Mapping[Key, Callable[[], object]], repeats: int, warm_up: int = 1, seconds: float = 0.0
) -> dict[Key, list[float]]:
    """Milliseconds of every task in ``repeats`` rounds, after ``warm_up`` rounds that do not count.

    seconds: how long a task runs untimed before each time that counts.
    """
    found: dict[Key, list[float]] = {key: [] for key in tasks}
    for _ in range(warm_up + repeats):
        for key, task in tasks.items():
            until = time.perf_counter() + seconds
            while time.perf_counter() < until:
                task()
            start = time.perf_counter()
            task()
            found[key].append(1e3 * (time.perf_counter() - start))
    return {key: times[warm_up:] for key, times in found.items()}
