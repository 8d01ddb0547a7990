"""The log of a run: one CSV row per interval, and the PSNR around the quantisation switch."""

from __future__ import annotations

import csv
import io
import math
import time
from pathlib import Path
from typing import Any

from clgs.errors import DataError
from clgs.files import append, atomic_write, is_full, text_bytes
from clgs.train.run.trainer import StepResult

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
