"""Progress bars and tables on the terminal; plain lines if the output is not a terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from clgs.cli.live import Live
from clgs.cli.stages import describe
from clgs.cli.tell import tell
from clgs.train.run.finished_run import RunResult
from clgs.train.run.session import Progress as TrainingProgress

Item = TypeVar("Item")
MET = 0.02
"""Share of a target size that may be left over without a word."""

WIDE = 120
"""Columns of a terminal from which training has a bar; without it, its figures fit in 80."""

PLAIN_SECONDS = 15.0
"""Without a terminal, one line is printed this often."""


@contextmanager
def bar(total: int | None, label: str) -> Iterator[Callable[[], None]]:
    """A bar of ``total`` units, None if that is not known; without a terminal, a line now and then.

    The block receives a function that advances it by one.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    console = Console(stderr=True)
    quiet = not console.is_terminal
    with Progress(*columns, TimeRemainingColumn(), console=console, disable=quiet) as progress:
        task = progress.add_task(label, total=total)
        yield _Lines(label, total or 0) if quiet else lambda: progress.advance(task)


class _Lines:
    """Counts, and prints a line every PLAIN_SECONDS."""

    def __init__(self, label: str, total: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._label, self._total, self._clock = label, total, clock
        self._done, self._began = 0, clock()
        self._printed = self._began

    def __call__(self) -> None:
        self._done += 1
        now = self._clock()
        if now - self._printed >= PLAIN_SECONDS:
            self._printed = now
            line = describe(self._label, self._done, self._total, now - self._began)
            tell(line)


def track(items: list[Item], label: str) -> Iterable[Item]:
    """Iterate over ``items`` and show a bar."""
    with bar(len(items), label) as advance:
        for item in items:
            yield item
            advance()


class TrainingDisplay(Live):
    """Step, steps per second, time left, PSNR, anchors and estimated bytes of a training run."""

    def __init__(self, steps: int, done: int) -> None:
        """A run of ``steps``, of which ``done`` are done already."""
        self._console = Console(stderr=True)
        wide = self._console.width >= WIDE
        self._progress = Progress(
            *((BarColumn(40),) if wide else ()),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            *((TimeElapsedColumn(),) if wide else ()),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task = self._progress.add_task("", total=steps, completed=done, rate="", note="")
        self._steps, self._start_step = steps, done
        self._start = time.perf_counter()
        self._printed = self._start
        self._psnr = self._size = ""

    def update(self, progress: TrainingProgress) -> None:
        """Show the state after a step."""
        if progress.psnr is not None:
            self._psnr = f"train {progress.psnr:.2f} dB"
        if progress.estimated_bytes is not None:
            self._size = f"~{progress.estimated_bytes / 1e6:.2f} MB"
        now = time.perf_counter()
        step = progress.result.step
        speed = f"{(step - self._start_step) / max(now - self._start, 1e-9):.1f} it/s"
        parts = (self._psnr, f"{progress.result.anchors:,} anchors", self._size)
        note = "  ".join(part for part in parts if part)
        self._progress.update(self._task, completed=step, rate=speed, note=note)
        due = now - self._printed > PLAIN_SECONDS or step == self._steps
        if due and not self._console.is_terminal:
            self._printed = now
            tell(f"step {step}/{self._steps}  {speed}  {note}")


def print_profile(rows: list[tuple[str, int, float, float]], skips: list[dict[str, Any]]) -> None:
    """Table of the stages' times, ``Profile.rows``, and of what each skip saved.

    A skip is a ``clgs.lab.savings.Saving`` as a dictionary, with its share.
    """
    table = Table("stage", title="Time by stage")
    for column in ("calls", "median ms", "total s", "share"):
        table.add_column(column, justify="right")
    total = sum(seconds for *_, seconds in rows) or 1.0
    for name, calls, milliseconds, seconds in rows:
        share = f"{100 * seconds / total:.1f} %"
        table.add_row(name, str(calls), f"{milliseconds:.2f}", f"{seconds:.1f}", share)
    console = Console()
    console.print(table)
    table = Table("skip", "work", title="Work left out, on the first view")
    for column in ("done", "without", "saved"):
        table.add_column(column, justify="right")
    for one in skips:
        counts = f"{one['done']:,}", f"{one['without']:,}", f"{100 * one['share']:.1f} %"
        table.add_row(one["skip"], one["unit"], *counts)
    console.print(table)


def print_summary(result: RunResult) -> None:
    """One line with the scores, and one with the files."""
    summary = result.summary
    trained = f" ({summary['train_psnr']:.2f} in training)" if "train_psnr" in summary else ""
    split = "held-out" if summary["split"] == "test" else "training"
    print(
        f"{split} views: PSNR {summary['psnr']:.2f} dB{trained}, SSIM {summary['ssim']:.4f}; "
        f"{summary['bytes']:,} bytes, {summary['anchors']:,} anchors, "
        f"{summary['train_seconds']:.0f} s"
    )
    missing = 1 - summary["bytes"] / (summary.get("target_size") or summary["bytes"])
    if missing > MET:
        print(
            f"the file is {100 * missing:.1f} % smaller than asked for: so short a run, or one "
            "with so few anchors, cannot fill it"
        )
    print(f"{result.folder / 'scene.clgs'}  {result.folder / 'results.json'}")
