"""Scores in the files that the 3DGS family's scripts and its compression survey read.

PSNR in both is ``psnr``: 8-bit pictures, one MSE over all channels, as the family's script computes
it from the PNG files of a model.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from clgs.errors import UsageError
from clgs.exports.image import picture_names
from clgs.files import append, atomic_write, atomic_write_all
from clgs.train.quality.score_views import ViewScore

METRICS = {
    "SSIM": "ssim",
    "PSNR": "psnr",
    "LPIPS": "lpips",
    "PSNR channel mean": "psnr_channel_mean",
}
"""Names in the family's files, and ours; the last is no part of them, and marks the other form."""

HEADER = ("Submethod", "PSNR", "SSIM", "LPIPS", "Size [Bytes]", "#Gaussians")
"""Columns of the tables of results of the 3DGS compression survey, one file per scene."""

FILES = ("results.json", "per_view.json")


def write_inria(
    folder: Path, method: str, summary: dict[str, Any], scores: Sequence[ViewScore]
) -> None:
    """Write results.json and per_view.json, both or none, as metrics.py of graphdeco's 3DGS does.

    The first holds {method: {metric: mean}}, the second {method: {metric: {picture: score}}}, with
    the pictures under the names that ``clgs render`` gives them. A metric that was not measured is
    left out. ``method``: for example "ours_30000"; ``summary`` is from ``summarize``, ``scores``
    from ``evaluate_views``.
    """
    measured = {theirs: ours for theirs, ours in METRICS.items() if ours in summary}
    names = picture_names([score.name for score in scores])
    views = {
        theirs: {name: getattr(one, ours) for name, one in zip(names, scores, strict=True)}
        for theirs, ours in measured.items()
    }
    means = {theirs: summary[ours] for theirs, ours in measured.items()}
    folder.mkdir(parents=True, exist_ok=True)
    documents = zip(FILES, (means, views), strict=True)
    atomic_write_all(
        {
            folder / name: (json.dumps({method: value}, indent=1) + "\n").encode()
            for name, value in documents
        }
    )


def check_survey(path: Path) -> None:
    """Refuse a file that is there and is not a table of the survey.

    Raises:
        UsageError: its first line is another one.
    """
    if not path.exists() or not path.stat().st_size:
        return
    with path.open("rb") as file:
        first = file.readline(200).decode(errors="replace").strip()
    if first != ",".join(HEADER):
        raise UsageError(f"{path}: line 1 is not {','.join(HEADER)}; name another file")


def append_survey(path: Path, submethod: str, summary: dict[str, Any]) -> None:
    """Add a row to the table ``path``, all of it or nothing; a new table gets its header too.

    Numbers are written in full; LPIPS is empty if it was not measured. ``submethod``: what the
    survey appends to a method's name, "Baseline" for nothing; ``summary``: from ``summarize``, with
    "bytes" and "gaussians".

    Raises:
        UsageError: as :func:`check_survey`.
        OSError: ``path`` cannot be written.
    """
    check_survey(path)
    numbers = (summary.get(name, "") for name in ("psnr", "ssim", "lpips", "bytes", "gaussians"))
    row = _line([submethod, *numbers])
    if not path.exists() or not path.stat().st_size:
        atomic_write(path, _line(HEADER) + row)
    else:
        append(path, row if path.read_bytes().endswith(b"\n") else b"\n" + row)


def _line(cells: Sequence[Any]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue().encode()
