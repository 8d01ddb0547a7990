"""The log of a run: one CSV row an interval, and the PSNR around the quantisation switch."""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import Any

from clgs.errors import DataError
from clgs.train.loop import StepResult

COLUMNS = ("step", "seconds", "loss", "l1", "ssim", "psnr", "anchors", "estimated_bytes", "event")


class ProgressLog:
    """Appends to ``progress.csv``; a resumed run first drops the rows after its checkpoint."""

    def __init__(self, path: Path, steps_done: int) -> None:
        """Open ``path`` to continue after step ``steps_done``."""
        rows = _read(path, steps_done) if steps_done else []
        self._file = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.DictWriter(self._file, COLUMNS)
        self._writer.writeheader()
        self._writer.writerows(rows)
        self._file.flush()
        self.events: dict[str, float] = {
            row["event"]: float(row["psnr"]) for row in rows if row["event"]
        }
        spent = float(rows[-1]["seconds"]) if rows else 0.0
        self._start = time.perf_counter() - spent
        self.seconds = spent

    def write(self, result: StepResult, psnr: float, estimated_bytes: int) -> None:
        """One row of the regular log."""
        self._row(
            step=result.step,
            loss=f"{result.loss:.6f}",
            l1=f"{result.l1:.6f}",
            ssim=f"{result.ssim:.6f}",
            psnr=f"{psnr:.3f}",
            anchors=result.anchors,
            estimated_bytes=estimated_bytes,
        )

    def event(self, step: int, name: str, psnr: float) -> None:
        """A row for something that happens once, with the PSNR at that moment."""
        self.events[name] = psnr
        self._row(step=step, psnr=f"{psnr:.3f}", event=name)

    def close(self) -> None:
        """Finish the file; ``seconds`` then holds the time of all legs of the run."""
        self._file.close()
        self.seconds = time.perf_counter() - self._start

    def _row(self, **values: Any) -> None:
        seconds = f"{time.perf_counter() - self._start:.1f}"
        self._writer.writerow({"seconds": seconds, **values})
        self._file.flush()


def _read(path: Path, steps_done: int) -> list[dict[str, str]]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [row for row in csv.DictReader(file) if int(row["step"]) <= steps_done]
    except FileNotFoundError:
        return []
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path}: not a progress log ({error}); remove it and resume again") from (
            None
        )
