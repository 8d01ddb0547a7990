"""SOG files of PlayCanvas, version 2: a zip archive of lossless WebP images and meta.json.

A pixel holds a Gaussian. Positions: 16 bits of sign(x) log(1 + |x|) between its extremes; scales
and base colors: a byte that points into a table of 256 numbers; rotations: the three smallest
components; opacity: a byte; the other coefficients of the color: two bytes that point into a
palette of sets of them, each coefficient a byte that points into a third table.

Source of the format: PlayCanvas' specification (developer.playcanvas.com, "The SOG format").
"""

from __future__ import annotations

import io
import json
import zipfile
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.splats.numbers import from_smallest_three, logit
from clgs.data.splats.table import PlyTable
from clgs.scene.gaussians import MAX_DEGREE

ZIP = b"PK\x03\x04"
META = "meta.json"
VERSION = 2
MODEL = "antialiased"
"""The `model` in meta.json of splats that are meant for antialiased drawing."""
COORDINATE_STEPS = 65535
ROTATION_TAG = 252
"""The tag of rotations whose w is largest; those of x, y and z follow."""
PALETTE_COLUMNS = 64
"""Sets of coefficients in a row of the palette's image."""
MAX_META = 1 << 20
MAX_SIDE = 1 << 14
"""WebP images are no wider or higher."""

Floats = npt.NDArray[np.float64]


def decode_sog(data: bytes) -> PlyTable:
    """The columns of a SOG file by the names of 3DGS's properties.

    Raises:
        ValueError: cut, damaged, or of another version.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _decode(archive)
    except (KeyError, TypeError, IndexError, OverflowError, RecursionError) as error:
        raise ValueError(f"a .sog file whose {META} is damaged: {error}") from None
    except (zipfile.BadZipFile, NotImplementedError, EOFError) as error:
        raise ValueError(f"a .sog file that is damaged: {error}") from None


def _decode(archive: zipfile.ZipFile) -> PlyTable:
    if META not in archive.namelist():
        raise ValueError(f"a zip archive without {META}, so no .sog file")
    if archive.getinfo(META).file_size > MAX_META:
        raise ValueError(f"a .sog file whose {META} is larger than 1 MiB")
    meta = json.loads(archive.read(META))
    if meta.get("version") != VERSION:
        raise ValueError(f"a .sog file of version {meta.get('version', 1)}; version 2 is read")
    count = int(meta["count"])

    def pixels(part: str, number: int = 0, whole: bool = False) -> npt.NDArray[np.int64]:
        image = _image(archive, meta[part]["files"][number])
        if whole:
            return image
        rows = image.reshape(-1, 4)
        if not 0 <= count <= len(rows):
            raise ValueError(f"a .sog file of {count} splats, of which {part} holds {len(rows)}")
        return rows[:count]

    def table(part: str) -> Floats:
        book = np.asarray(meta[part]["codebook"], np.float64)
        if book.ndim != 1 or len(book) < 1:
            raise ValueError(f"a .sog file without a codebook of {part}")
        return np.pad(book, (0, max(0, 256 - len(book))), mode="edge")

    steps = pixels("means", 0)[:, :3] + 256 * pixels("means", 1)[:, :3]
    least, most = (np.array(meta["means"][end], np.float64).reshape(3) for end in ("mins", "maxs"))
    logs = least + np.where(most > least, most - least, 1.0) * (steps / COORDINATE_STEPS)
    position = np.sign(logs) * np.expm1(np.abs(logs))
    scale = table("scales")[pixels("scales")[:, :3]]
    turned, first = pixels("quats"), pixels("sh0")
    small = (turned[:, :3] / 255.0 - 0.5) * np.sqrt(2)
    rotation = from_smallest_three(np.clip(turned[:, 3] - ROTATION_TAG, 0, 3), small)
    color = table("sh0")[first[:, :3]]
    found = {axis: position[:, i] for i, axis in enumerate("xyz")}
    found |= {f"f_dc_{i}": color[:, i] for i in range(3)}
    if "shN" in meta:
        found |= _rest(meta["shN"], pixels, table("shN"))
    found["opacity"] = logit(first[:, 3] / 255.0)
    found |= {f"scale_{i}": scale[:, i] for i in range(3)}
    found |= {f"rot_{i}": rotation[:, i] for i in range(4)}
    antialiased = meta.get("model") == MODEL or meta.get("antialias") is True
    columns: dict[str, npt.NDArray[Any]] = {
        name: column if name in "xyz" else column.astype(np.float32)
        for name, column in found.items()
    }
    return PlyTable(columns, ["antialiased 1"] if antialiased else [])


def _rest(meta: dict[str, Any], pixels: Any, table: Floats) -> dict[str, Floats]:
    """The columns f_rest_* of the palette."""
    degree, entries = int(meta["bands"]), int(meta["count"])
    if not 1 <= degree <= MAX_DEGREE:
        raise ValueError(f"a .sog file with {degree} bands of coefficients")
    width = (degree + 1) ** 2 - 1
    centroids, labels = pixels("shN", 0, whole=True), pixels("shN", 1)
    label = labels[:, 0] + 256 * labels[:, 1]
    sets = centroids[:, : PALETTE_COLUMNS * width, :3]
    if sets.shape[1] != PALETTE_COLUMNS * width or entries > len(sets) * PALETTE_COLUMNS:
        raise ValueError("a .sog file whose palette is smaller than it says")
    if (label >= entries).any():
        raise ValueError("a .sog file that points behind its palette")
    values = table[sets.reshape(-1, width, 3)[label]]
    return {f"f_rest_{width * c + i}": values[:, i, c] for c in range(3) for i in range(width)}


def _image(archive: zipfile.ZipFile, name: str) -> npt.NDArray[np.int64]:
    """The pixels (H, W, 4) of an image."""
    from PIL import Image, UnidentifiedImageError

    if archive.getinfo(name).file_size > 4 * MAX_SIDE**2:
        raise ValueError(f"{name} in a .sog file is larger than any image")
    try:
        with Image.open(io.BytesIO(archive.read(name))) as image:
            if max(image.size) > MAX_SIDE:
                raise ValueError(f"{name} in a .sog file has more than {MAX_SIDE} pixels a side")
            return np.asarray(image.convert("RGBA"), np.int64)
    except (UnidentifiedImageError, OSError, Image.DecompressionBombError) as error:
        raise ValueError(f"{name} in a .sog file is damaged: {error}") from None
