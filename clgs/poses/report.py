"""The files of a data set that describe its verdict: report.json and a sheet of all photos."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from clgs.data.images import read_image
from clgs.poses.judging.verdict import Verdict

REPORT = "report.json"
CONTACT_SHEET = "contact_sheet.jpg"
"""All photos of the verdict, in its order; see :func:`contact_sheet`."""

COLUMNS = 8
CELL = (160, 120)
"""Width and height of a photo on the sheet, pixels."""

QUALITY = 80


def write_report(folder: Path, verdict: Verdict, images: Path) -> None:
    """Write both files into ``folder``; the photos of the verdict are in ``images``.

    Raises:
        DataError: a photo is damaged.
        OSError: a file cannot be written.
    """
    sheet = contact_sheet([images / photo.name for photo in verdict.photos])
    (folder / CONTACT_SHEET).write_bytes(sheet)
    report = json.dumps(verdict.plain(), indent=1, allow_nan=False)
    (folder / REPORT).write_text(report + "\n", encoding="utf-8")


def contact_sheet(photos: Sequence[Path]) -> bytes:
    """Make a JPEG file: COLUMNS photos per row, each reduced to fit into the middle of its CELL.

    Raises:
        DataError: a photo is damaged.
    """
    width, height = CELL
    rows = -(-len(photos) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * width, max(rows, 1) * height), (128, 128, 128))
    for number, path in enumerate(photos):
        picture = Image.fromarray(read_image(path).color)
        picture.thumbnail(CELL)
        row, column = divmod(number, COLUMNS)
        left = column * width + (width - picture.width) // 2
        sheet.paste(picture, (left, row * height + (height - picture.height) // 2))
    buffer = io.BytesIO()
    sheet.save(buffer, "JPEG", quality=QUALITY)
    return buffer.getvalue()
