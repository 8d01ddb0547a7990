"""All photos of a capture as one picture."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from clgs.data.images import read_image

COLUMNS = 8
CELL = (160, 120)
"""Width and height of a photo on the sheet, pixels."""

QUALITY = 80


def contact_sheet(photos: Sequence[Path]) -> bytes:
    """A JPEG file: COLUMNS photos a row, each reduced to fit into the middle of its CELL.

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
