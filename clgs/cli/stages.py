"""Progress of work in stages: a bar for the stage on a terminal, else a line now and then."""

from __future__ import annotations

import time
from collections.abc import Callable

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from clgs.cli.live import Live
from clgs.cli.tell import tell

PLAIN_SECONDS = 10.0
"""Without a terminal, a stage prints one line this often, and one when it is complete."""


class StageDisplay(Live):
    """What of which stage is done, and the time left of it."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """``clock`` tells seconds."""
        console = Console(stderr=True)
        self._plain = not console.is_terminal
        self._progress = Progress(
            TextColumn("{task.description:<11}"),
            BarColumn(20),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=self._plain,
        )
        self._task = self._progress.add_task("", total=None)
        self._clock = clock
        self._stage, self._said = "", ""
        self._began = self._printed = clock()

    def update(self, stage: str, done: int, total: int) -> None:
        """Show ``done`` of ``total`` of a stage; total 0 if that is not known."""
        new = stage != self._stage
        if not (new or total):
            return  # something beside that cannot tell how far it is
        if new:
            self._stage, self._began = stage, self._clock()
            self._progress.reset(self._task)
        self._progress.update(self._task, description=stage, completed=done, total=total or None)
        if self._plain:
            self._print(new, done, total)

    def _print(self, new: bool, done: int, total: int) -> None:
        now = self._clock()
        complete = bool(total) and done == total
        if not (new or complete or now - self._printed >= PLAIN_SECONDS):
            return
        line = describe(self._stage, done, total, now - self._began)
        if line != self._said:
            self._said, self._printed = line, now
            tell(line)


def describe(stage: str, done: int, total: int, seconds: float) -> str:
    """One line: the stage, what is done, the time that it took and that is left."""
    parts = [f"{stage} {done}/{total}" if total else stage]
    if seconds >= 1:
        parts.append(f"{seconds:.0f} s")
    if 0 < done < total and seconds >= 1:
        parts.append(f"about {seconds * (total - done) / done:.0f} s left")
    return ", ".join(parts)
