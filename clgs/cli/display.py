"""The one display of progress: a bar on a terminal, else a line now and then."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from clgs.cli.tell import tell
from clgs.workflow.events import Event, Note, StageProgress, TrainingProgress

WIDE = 120
"""Columns of a terminal from which training has a bar; without it, its figures fit in 80."""

PLAIN_SECONDS = 10.0
"""Without a terminal a line is printed this often, and one when a stage is complete."""


class Display:
    """Shows the notes and the progress of a workflow, whose callback it is.

    Use it as a context manager: no bar is left after the block.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """``clock`` gives seconds."""
        self._console = Console(stderr=True)
        self._clock = clock
        self._bar: Progress | None = None
        self._stage = ""
        self._first, self._began, self._printed = 0, clock(), clock()
        self._complete = False
        self._psnr = self._size = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Remove the bar; the next event of a stage begins another one."""
        if self._bar is not None:
            self._bar.stop()
        self._bar, self._stage = None, ""

    def __call__(self, event: Event) -> None:
        """Show an event; results of stages are the command's to print."""
        match event:
            case Note(text):
                tell(f"clgs: {text}")
            case StageProgress(stage, done, total):
                if stage != self._stage:
                    self._begin(stage, done)
                self._update(done, total, "")
            case TrainingProgress(progress, steps):
                step = progress.result.step
                if self._stage != "training":
                    self._begin("training", step)
                    self._psnr = self._size = ""
                if progress.psnr is not None:
                    self._psnr = f"train {progress.psnr:.2f} dB"
                if progress.estimated_bytes is not None:
                    self._size = f"~{progress.estimated_bytes / 1e6:.2f} MB"
                seconds = max(self._clock() - self._began, 1e-9)
                speed = f"{(step - self._first) / seconds:.1f} it/s"
                anchors = f"{progress.result.anchors:,} anchors"
                parts = (speed, self._psnr, anchors, self._size)
                self._update(step, steps, "  ".join(part for part in parts if part))

    def _begin(self, stage: str, first: int) -> None:
        """Begin a stage of which ``first`` are done already."""
        self.stop()
        self._stage, self._first, self._complete = stage, first, False
        self._began = self._printed = self._clock()
        if not self._console.is_terminal:
            return
        training = stage == "training"
        columns: list[ProgressColumn] = []
        if not training or self._console.width >= WIDE:
            columns += [TextColumn("{task.description:<11}"), BarColumn(20), TimeElapsedColumn()]
        columns += [MofNCompleteColumn(), TimeRemainingColumn()]
        columns += [TextColumn("{task.fields[note]}")] * training
        self._bar = Progress(*columns, console=self._console, transient=True)
        self._bar.add_task(stage, total=None, completed=first, note="")
        self._bar.start()

    def _update(self, done: int, total: int, note: str) -> None:
        if self._bar is not None:
            (task,) = self._bar.task_ids
            self._bar.update(task, completed=done, total=total or None, note=note)
            return
        now = self._clock()
        complete = done == total > 0 and not self._complete
        if complete or now - self._printed >= PLAIN_SECONDS:
            self._printed, self._complete = now, complete or self._complete
            line = describe(self._stage, done, total, now - self._began, self._first)
            tell(f"{line}  {note}" if note else line)


def describe(stage: str, done: int, total: int, seconds: float, first: int = 0) -> str:
    """One line: the stage, what is done, the seconds that it took, and those that are left.

    ``first`` of ``done`` were done before these seconds began.
    """
    parts = [f"{stage} {done}/{total}" if total else stage]
    if seconds >= 1:
        parts.append(f"{seconds:.0f} s")
        if first < done < total:
            parts.append(f"about {seconds * (total - done) / (done - first):.0f} s left")
    return ", ".join(parts)
