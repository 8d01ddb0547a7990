"""The progress of many runs at once: a bar for all, and one for each that is under way."""

from __future__ import annotations

import sys
import threading
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from reproduce.worker import Row

PLAIN_SHARE = 4
"""Without a terminal, a run prints a line at every such part of its steps."""


class Display:
    """Bars on a terminal, else lines; messages come from another thread than rows."""

    def __init__(self, names: dict[str, str]) -> None:
        """``names``: of each run that is to come, what it is called."""
        self._names = names
        self._console = Console(stderr=True)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._all = self._progress.add_task("runs", total=len(names), note="")
        self._bars: dict[str, TaskID] = {}
        self._parts: dict[str, int] = {}
        self._done: set[str] = set()
        self._lock = threading.Lock()

    def __enter__(self) -> Display:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def message(self, message: dict[str, Any]) -> None:
        """Show how far a run is."""
        run, step, steps = message["run"], message["step"], message["steps"]
        with self._lock:
            if run in self._done or run not in self._names:
                return
            if run not in self._bars:
                name = self._names[run]
                self._bars[run] = self._progress.add_task(name, total=steps, note="")
            self._progress.update(self._bars[run], completed=step, note=message["doing"])
            part = PLAIN_SHARE * step // steps
            if part != self._parts.get(run):
                self._parts[run] = part
                self._say(f"{self._names[run]}: step {step}/{steps}")

    def row(self, row: Row) -> None:
        """A run has ended."""
        run = row["run"]
        with self._lock:
            self._done.add(run)
            if run in self._bars:
                self._progress.remove_task(self._bars.pop(run))
            self._progress.advance(self._all)
            if "error" in row:
                print(f"reproduce: {self._names[run]}: {row['error']}", file=sys.stderr, flush=True)
                return
            figures = f"{row['psnr']:.2f} dB, {row['bytes']:,} bytes, {row['seconds']:.0f} s"
            self._say(f"{self._names[run]}: {figures}; {len(self._done)} of {len(self._names)}")

    def _say(self, line: str) -> None:
        if not self._console.is_terminal:
            print(line, file=sys.stderr, flush=True)
