"""Many scenes, each trained as a task: `clgs batch`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from clgs.cluster.block_run import train_in_blocks
from clgs.cluster.engine import Message, connected, require_distributed, run_tasks
from clgs.cluster.table import read_scenes
from clgs.cluster.worker import Reporter, Row, Task, Tell, forget_peak_memory
from clgs.files import make_folder
from clgs.train.config import layered
from clgs.workflow.events import Event, Note, StageProgress, TrainingProgress
from clgs.workflow.train import train

FIGURES = ("psnr", "ssim", "bytes", "anchors", "train_seconds", "peak_memory_bytes")
"""What a row has of the summary of its run."""


def train_scenes(
    table: Path,
    output: Path,
    workers: int = 1,
    scheduler: str | None = None,
    device: str | None = None,
    on_row: Callable[[Row], None] = lambda row: None,
    on_message: Callable[[Message], None] = lambda message: None,
) -> list[Row]:
    """Train the scenes of a table; ``output``/NAME receives the run of each.

    Runs that were interrupted go on from their checkpoints, finished ones are read. A scene that
    fails has a row with ``error`` and ``exit_code``, and the others go on.

    Args:
        table: as :func:`clgs.cluster.table.read_scenes` reads it.
        output: folder of the runs; all machines see it, and the data, under the same names.
        workers: processes on this machine.
        scheduler: address of a scheduler of dask, in place of them.
        device: number or part of the name, as workers see it.
        on_row: called as each scene ends, with its row.
        on_message: called, in another thread, with run, step, steps and what is being done.

    Raises:
        ClgsError: dask.distributed is not installed.
        UsageError: the table or the scheduler cannot be used, or a worker is refused.
    """
    require_distributed()
    tasks = read_scenes(table, output)
    make_folder(output)
    with connected(workers, scheduler) as client:
        return run_tasks(
            client, train_one, tasks, output / "kernels", on_row, on_message, device=device
        )


def train_one(task: Task, tell: Tell = lambda message: None) -> Row:
    """Train the scene of a task, as of :func:`clgs.cluster.table.read_scenes`; its row.

    Blocks of one are trained one after the other.

    Raises:
        ClgsError, OSError: as :func:`clgs.workflow.train.train`.
    """
    forget_peak_memory()
    config = layered(task["settings"])
    reporter = Reporter(task["run"], config.steps, tell)
    reporter.now("reading photos")

    def follow(event: Event) -> None:
        if isinstance(event, TrainingProgress):
            reporter.progress(event.progress)
        elif isinstance(event, Note):
            reporter.now(event.text)
        elif isinstance(event, StageProgress):
            reporter.now(f"{event.stage} {event.done}/{event.total}")

    work = train if task.get("blocks") is None else partial(train_in_blocks, blocks=task["blocks"])
    trained = work(
        Path(task["data"]),
        Path(task["folder"]),
        config,
        device=task.get("device"),
        resume=True,
        command=task.get("command", ""),
        on_event=follow,
    )
    summary = trained.result.summary
    figures = {name: summary[name] for name in FIGURES if name in summary}
    return {"run": task["run"], "was_finished": trained.was_finished, **figures}
