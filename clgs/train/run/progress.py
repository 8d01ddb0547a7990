"""What a run writes while it trains: its log, and checkpoints.

The log has one CSV row per interval, and the PSNR around the quantisation switch. The disk may be
full: no trained step is lost before it must be.
"""

from __future__ import annotations

import csv
import io
import logging
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from clgs.errors import ClgsError, DataError, is_full
from clgs.files import append, atomic_write, text_bytes
from clgs.train.run.trainer import StepResult, Trainer

COLUMNS = ("step", "seconds", "loss", "l1", "ssim", "psnr", "anchors", "estimated_bytes", "event")


class ProgressLog:
    """Appends to ``progress.csv``; a resumed run first drops the rows after its checkpoint.

    While the disk is full, rows wait.
    """

    def __init__(self, path: Path, steps_done: int) -> None:
        """Open ``path`` to continue after step ``steps_done``.

        Raises:
            DataError: the file is damaged; it stays as it was.
        """
        rows = _read(path, steps_done) if steps_done else []
        self._path = path
        self.events = {row["event"]: float(row["psnr"]) for row in rows if row["event"]}
        self.seconds = float(rows[-1]["seconds"]) if rows else 0.0
        self._start = time.perf_counter() - self.seconds
        atomic_write(path, text_bytes(_text(rows)))
        self._waiting: list[dict[str, Any]] = []

    def write(self, result: StepResult, psnr: float | None, estimated_bytes: int) -> None:
        """One row of the regular log; ``psnr``: None if no view is measured."""
        self._row(
            step=result.step,
            loss=f"{result.loss:.6f}",
            l1=f"{result.l1:.6f}",
            ssim=f"{result.ssim:.6f}",
            psnr="" if psnr is None else f"{psnr:.3f}",
            anchors=result.anchors,
            estimated_bytes=estimated_bytes,
        )

    def event(self, step: int, name: str, psnr: float) -> None:
        """A row for something that happens once, with the PSNR at that moment."""
        self.events[name] = psnr
        self._row(step=step, psnr=f"{psnr:.3f}", event=name)

    def close(self) -> None:
        """Stop the clock; ``seconds`` then holds the time of all legs of the run."""
        self.seconds = time.perf_counter() - self._start

    def flush(self) -> None:
        """Write the rows that wait.

        Raises:
            OSError: the disk is full, or another fault of the file; the rows go on waiting.
        """
        append(self._path, text_bytes(_text(self._waiting, header=False)))
        self._waiting = []

    def _row(self, **values: Any) -> None:
        seconds = f"{time.perf_counter() - self._start:.1f}"
        self._waiting.append({"seconds": seconds, **values})
        try:
            self.flush()
        except OSError as error:
            if not is_full(error):
                raise


def _text(rows: list[dict[str, Any]], header: bool = True) -> str:
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS)
    if header:
        writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _read(path: Path, steps_done: int) -> list[dict[str, str]]:
    """The rows up to step ``steps_done``, their numbers checked.

    A last line without an end is what a full disk or a power cut left of a row; it is skipped.
    """
    try:
        whole = path.read_bytes()
    except FileNotFoundError:
        return []
    try:
        lines = whole[: whole.rfind(b"\n") + 1].decode().splitlines()
        reader = csv.DictReader(lines)
        if lines and reader.fieldnames != list(COLUMNS):
            raise ValueError("its first line does not name the columns")
        return [row for row in reader if _checked(row, reader.line_num) <= steps_done]
    except (ValueError, csv.Error) as error:
        raise DataError(f"{path}: not a progress log ({error}); remove it and resume again") from (
            None
        )


def _checked(row: dict[str, Any], line: int) -> int:
    """The step of a row; raises ValueError if a field that is read again is no number."""
    if None in row or None in row.values():
        raise ValueError(f"line {line} has not {len(COLUMNS)} fields")
    try:
        if row["event"]:
            float(row["psnr"])
        if not 0.0 <= float(row["seconds"]) < math.inf:
            raise ValueError
        return int(row["step"])
    except ValueError:
        raise ValueError(f"line {line}: step, seconds or psnr is not a number") from None


Result = TypeVar("Result")

RETRY_STEPS = 100
"""After a checkpoint that found no room, steps until the next try."""

WAIT_SECONDS = 600.0
"""How long a trained scene that is on no disk waits for room."""

WAIT_INTERVAL = 5.0
"""Seconds between two tries of a waiting scene."""

_log = logging.getLogger(__name__)


class FullDiskError(ClgsError):
    """No room for a file of a run: names it, the remedy, and the step that a resumed run has."""


class Keeper:
    """Writes the checkpoints of a run."""

    def __init__(self, folder: Path, trainer: Trainer) -> None:
        """Keep ``trainer``, whose present state is on the disk already; ``folder``: run folder."""
        self._folder, self._trainer = folder / "checkpoint", trainer
        self._saved_step = trainer.steps_done
        self._full = False

    @property
    def interval(self) -> int:
        """Steps between checkpoints; 0 for none."""
        interval = self._trainer.config.checkpoint_interval
        return min(interval, RETRY_STEPS) if self._full else interval

    def save(self) -> None:
        """Write a checkpoint if the newest is of another step.

        Raises:
            FullDiskError: there is no room, even without the checkpoint before the newest.
            ClgsError: the file cannot be written.
        """
        if self._is_saved():
            return
        try:
            self._trainer.save(self._folder)
        except ClgsError as error:
            if isinstance(error.__cause__, OSError) and is_full(error.__cause__):
                raise self._no_room(error.__cause__) from error
            raise
        self._saved_step, self._full = self._trainer.steps_done, False

    def try_save(self) -> None:
        """Do what :meth:`save` does; a full disk gives a warning, once, and makes tries frequent.

        Raises:
            ClgsError: the file cannot be written for another reason.
        """
        try:
            self.save()
        except FullDiskError as error:
            if not self._full:
                _log.warning("%s; training goes on and tries again", error)
            self._full = True

    def with_room(self, work: Callable[[], Result]) -> Result:
        """What ``work()`` gives; it is repeated while the disk is full and no checkpoint is whole.

        Raises:
            FullDiskError: no room came in WAIT_SECONDS, or the run can be resumed without loss.
            OSError: another failure of ``work``.
        """
        deadline, warned = time.monotonic() + WAIT_SECONDS, False
        while True:
            try:
                return work()
            except OSError as error:
                if not is_full(error):
                    raise
                if self._is_saved() or time.monotonic() >= deadline:
                    raise self._no_room(error) from error
                if not warned:
                    _log.warning(
                        "%s: %s; free space: the scene waits for it up to %.0f minutes",
                        *(error.filename, error.strerror, WAIT_SECONDS / 60),
                    )
                warned = True
            time.sleep(WAIT_INTERVAL)
            self.try_save()

    def _is_saved(self) -> bool:
        return self._saved_step == self._trainer.steps_done

    def _no_room(self, error: OSError) -> FullDiskError:
        again = f"goes on after step {self._saved_step}" if self._saved_step else "starts again"
        return FullDiskError(
            f"{error.filename}: {error.strerror}; free space, then repeat the command with "
            f"--resume: it {again}"
        )
