"""One task: train a run in its folder, or go on with it, measure its file, and keep the row.

A task is sent as a dictionary and answers with one. Only what is light is imported before it runs:
the folder of built kernels must be named first.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

from clgs.cluster.worker import Reporter, Row, Task, Tell, forget_peak_memory, opened_device
from clgs.files import atomic_write

ROW = "row.json"
"""The last file of a run: a folder that has it needs no more work."""

FIELDS = ("run", "settings", "psnr", "ssim", "bytes", "anchors", "sections")
"""What a row must have to be used."""


def run_job(job: Task, tell: Tell = lambda message: None) -> Row:
    """The row of a run: what its folder holds already is read, what is missing is made.

    Args:
        job: as :func:`reproduce.table.jobs` makes it.
        tell: called about once a second with run, step and steps.

    Raises:
        ClgsError, OSError: as :func:`clgs.load_dataset` and :func:`clgs.train_scene`.
    """
    folder = Path(job["folder"])
    folder.mkdir(parents=True, exist_ok=True)
    row = stored_row(folder, job["run"])
    if row is None:
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


def _make_row(job: Task, folder: Path, tell: Tell) -> Row:
    """Train and measure."""
    from clgs.machine import return_freed_memory
    from clgs.train.config import layered
    from clgs.train.run.load import load_for
    from clgs.train.run.session import train_scene
    from reproduce.measure import measure

    return_freed_memory()
    device = opened_device(job.get("device"))
    device.release_unused()
    forget_peak_memory()
    config = layered(job["settings"])
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
