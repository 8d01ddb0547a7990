"""One task: train a run in its folder, or go on with it, measure its file, and keep the row.

A task is sent as a dictionary and answers with one. Only what is light is imported before it runs:
the folder of built kernels must be named first.
"""

from __future__ import annotations

import json
import os
import platform
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clgs.errors import ClgsError
from clgs.files import atomic_write

if TYPE_CHECKING:
    from clgs.opencl.device import Device

Job = dict[str, Any]
Row = dict[str, Any]
Tell = Callable[[dict[str, Any]], None]

ROW = "row.json"
"""The last file of a run: a folder that has it needs no more work."""

TOPIC = "clgs-reproduce"
"""Topic of the messages on progress that workers send."""

INTERVAL = 1.0
"""Seconds between them."""

TRAINING = "training"
"""What a worker says that it does after a step."""

FIELDS = ("run", "settings", "psnr", "ssim", "bytes", "anchors", "sections")
"""What a row must have to be used."""

_alone = threading.Lock()
"""A process trains one run at a time, however many threads a worker has."""


def run_on_worker(job: Job) -> Row:
    """Like :func:`run_job`, in a worker of dask: an error of the user becomes a row with ``error``.

    Exceptions that must be sent back would be pickled; a row is plain data.
    """
    from distributed import get_worker

    worker = get_worker()
    kernels = Path(job["kernels"]) / re.sub(r"[^\w.-]", "_", f"{platform.node()}-{worker.name}")
    try:
        with _alone:
            return run_job(job, kernels, lambda message: worker.log_event(TOPIC, message))
    except (ClgsError, OSError) as error:
        from clgs.cli.main import explain

        message, code = explain(error)
        return {"run": job["run"], "error": message, "exit_code": code}


def run_job(job: Job, kernels: Path, tell: Tell = lambda message: None) -> Row:
    """The row of a run: what its folder holds already is read, what is missing is made.

    Args:
        job: as :func:`reproduce.table.jobs` makes it.
        kernels: where PoCL keeps built kernels, if POCL_CACHE_DIR names no place: processes side by
            side must not share one.
        tell: called about once a second with run, step and steps.

    Raises:
        ClgsError, OSError: as :func:`clgs.load_dataset` and :func:`clgs.train_scene`.
    """
    folder = Path(job["folder"])
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder / "lock"):
        row = stored_row(folder, job["run"])
        if row is None:
            os.environ.setdefault("POCL_CACHE_DIR", str(kernels))
            row = _make_row(job, folder, tell)
            atomic_write(folder / ROW, (json.dumps(row, indent=1) + "\n").encode())
    return row


def stored_row(folder: Path, run: str) -> Row | None:
    """The row that a run's folder holds; None if it has none that can be used."""
    try:
        row = json.loads((folder / ROW).read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError, ValueError, RecursionError):
        return None
    usable = isinstance(row, dict) and all(name in row for name in FIELDS) and row["run"] == run
    return row if usable else None


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Within the block no other process is; the system lets go of it when a process is killed.

    Where there are no such locks nothing happens.
    """
    try:
        import fcntl
    except ImportError:  # not on Windows
        yield
        return
    with path.open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _make_row(job: Job, folder: Path, tell: Tell) -> Row:
    """Train and measure."""
    from clgs.memory import return_freed_memory
    from clgs.train.run.load import load_for
    from clgs.train.run.session import train_scene
    from reproduce.measure import measure
    from reproduce.table import config_of

    return_freed_memory()
    device = _device()
    device.release_unused()
    forget_peak_memory()
    config = config_of(job)
    reporter = Reporter(job["run"], config.steps, tell)
    reporter.now("reading photos")
    start = time.perf_counter()
    dataset = load_for(config, job["data"], folder)
    load_seconds = time.perf_counter() - start
    result = train_scene(
        dataset, folder, config, device=device, resume=True, on_progress=reporter.progress
    )
    reporter.now("scoring")
    found = measure(folder / "scene.clgs", dataset, device, config.render_options())
    train_seconds = float(result.summary["train_seconds"])
    return {
        "run": job["run"],
        "settings": job["settings"],
        "steps": config.steps,
        **found,
        "load_seconds": load_seconds,
        "train_seconds": train_seconds,
        "seconds": load_seconds + train_seconds + found["encode_seconds"],
        "peak_memory_bytes": result.summary.get("peak_memory_bytes"),
        **job["facts"],
    }


class Reporter:
    """Says how far a run is, about once every INTERVAL."""

    def __init__(self, run: str, steps: int, tell: Tell) -> None:
        """Report on a run of ``steps`` steps."""
        self._run, self._steps, self._tell = run, steps, tell
        self._reported, self._step = -INTERVAL, 0

    def progress(self, progress: Any) -> None:
        """After every step; ``progress`` as of :func:`clgs.train_scene`."""
        self._step = progress.result.step
        if time.monotonic() - self._reported >= INTERVAL or self._step == self._steps:
            self.now(TRAINING)

    def now(self, doing: str) -> None:
        """Report at once; the first step after other work is reported at once, too."""
        self._reported = time.monotonic() if doing == TRAINING else -INTERVAL
        self._tell({"run": self._run, "step": self._step, "steps": self._steps, "doing": doing})


@cache
def _device() -> Device:
    """The device, opened once a process: its kernels stay built."""
    from clgs.opencl.device import Device

    return Device()


def forget_peak_memory() -> None:
    """Let the peak of this process's memory be that of now, where the system can (Linux)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
