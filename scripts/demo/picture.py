"""The demonstration's picture: a photo, its render from the file, and that file's bytes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

Picture = npt.NDArray[np.uint8]

WIDTH, GAP, CAPTION = 400, 8, 34
"""Pixels: of a panel, between panels, of the line of text below them."""

MIN_HEIGHT = 240
"""Least height of a panel: the bytes by section need it if photos are wide."""

SMALL = 0.01
"""Share of the file below which a section has no bar of its own."""

PAPER, INK, SOFT, MARK = (255, 255, 255), (28, 36, 48), (92, 102, 118), (47, 111, 176)


def draw_showcase(
    photo: Picture, render: Picture, psnr: float, sections: Mapping[str, int]
) -> Picture:
    """Three panels side by side, each with a line of text below it, (H, 3 WIDTH + 2 GAP, 3).

    photo and render: (H, W, 3) uint8 of one held-out view; psnr: of that view, dB; sections: bytes
    of the file by what they hold.
    """
    height = max(MIN_HEIGHT, round(WIDTH * photo.shape[0] / photo.shape[1]))
    page = Image.new("RGB", (3 * WIDTH + 2 * GAP, height + CAPTION), PAPER)
    captions = (
        "photo, held out of training",
        f"rendered from the file, {psnr:.1f} dB",
        f"the file: {sum(sections.values()):,} bytes",
    )
    panels = (_fitted(photo, height), _fitted(render, height), _bytes(sections, height))
    draw = ImageDraw.Draw(page)
    for index, (panel, caption) in enumerate(zip(panels, captions, strict=True)):
        left = index * (WIDTH + GAP)
        page.paste(panel, (left, 0))
        draw.text((left + 2, height + CAPTION // 2), caption, INK, _font(19), anchor="lm")
    return np.array(page)


def _fitted(picture: Picture, height: int) -> Image.Image:
    """The picture as wide as a panel, with paper below if it is less high."""
    panel = Image.new("RGB", (WIDTH, height), PAPER)
    high = min(height, round(WIDTH * picture.shape[0] / picture.shape[1]))
    panel.paste(Image.fromarray(picture).resize((WIDTH, high), Image.Resampling.LANCZOS))
    return panel


def _bytes(sections: Mapping[str, int], height: int) -> Image.Image:
    """Bytes by section, largest first, each as a bar; sections below SMALL are the last one."""
    total = sum(sections.values())
    large = {name: size for name, size in sections.items() if size >= SMALL * total}
    rows = sorted(large.items(), key=lambda row: -row[1])
    if rest := total - sum(large.values()):
        rows.append(("all else", rest))
    panel = Image.new("RGB", (WIDTH, height), (246, 247, 249))
    draw = ImageDraw.Draw(panel)
    pitch = (height - 24) // len(rows)
    for index, (name, size) in enumerate(rows):
        top = 12 + index * pitch
        length = max(1, round((WIDTH - 32) * size / rows[0][1]))
        draw.text((16, top), name, INK, _font(16))
        draw.text((WIDTH - 16, top), f"{size:,}", SOFT, _font(16), anchor="ra")
        bar = (16, top + 22, 16 + length, top + 22 + min(18, pitch - 28))
        draw.rectangle(bar, MARK)
    return panel


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
