"""SOG files of PlayCanvas, versions 1 and 2: lossless WebP images and meta.json, mostly in a zip.

A pixel holds a Gaussian. Positions: 16 bits of sign(x) log(1 + |x|) between its extremes; scales
and base colors: a byte that points into a table of 256 numbers; rotations: the three smallest
components; opacity: a byte; the other coefficients of the color: two bytes that point into a
palette of sets of them, each coefficient a byte that points into a third table. In version 1 the
tables are even steps between two extremes, and opacities are logits of such a table.

Source of the format: PlayCanvas' specification (developer.playcanvas.com, "The SOG format").
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.splats.ply import PlyTable
from clgs.files import SMALL, check_declared
from clgs.scene.gaussians import MAX_DEGREE, from_smallest_three, logit
from clgs.scene.storage import check_members

ZIP = b"PK\x03\x04"
META = "meta.json"
VERSION = 2
"""What is written; version 1 is read as well."""
MODEL = "antialiased"
"""The `model` in meta.json of splats that are meant for antialiased drawing."""
COORDINATE_STEPS = 65535
ROTATION_TAG = 252
"""The tag of rotations whose w is largest; those of x, y and z follow."""
PALETTE_COLUMNS = 64
"""Sets of coefficients in a row of the palette's image."""
MAX_META = 1 << 20
LARGEST_PALETTE = 1 << 21
"""Pixels; palettes have about 65,536 sets of 15 coefficients at most."""
PIXELS_OF_SPLAT = 6
"""Images that have a pixel for every splat."""

Floats = npt.NDArray[np.float64]
Open = Callable[[str], tuple[int, Callable[[], bytes]]]
"""The size of a file by name, and what reads it."""


def decode_sog(data: bytes, folder: Path | None = None) -> PlyTable:
    """The columns of a SOG file by the names of 3DGS's properties.

    Args:
        data: the zip archive, or meta.json.
        folder: of meta.json, with the images in it; None: ``data`` is an archive.

    Raises:
        ValueError: cut, damaged, or of another version.
    """
    try:
        if folder is not None:
            size = len(data) + sum(image.stat().st_size for image in images_in(folder))
            return _decode(data, size, partial(_in_folder, folder))
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            check_members(archive, len(data))
            # Who zips a folder may have its name before each file's.
            found = [n for n in archive.namelist() if PurePosixPath(n).name == META]
            if not found:
                raise ValueError(f"a zip archive without {META}, so no .sog file")
            meta = min(found, key=len)
            size, read = _in_archive(archive, meta)
            if size > MAX_META:
                raise ValueError(f"a .sog file whose {META} is larger than 1 MiB")
            before = meta.removesuffix(META)
            return _decode(read(), len(data), lambda name: _in_archive(archive, before + name))
    except (KeyError, TypeError, IndexError, AttributeError, ArithmeticError, RecursionError) as e:
        raise ValueError(f"a .sog file whose {META} is damaged: {e}") from None
    except (zipfile.BadZipFile, NotImplementedError, EOFError, RuntimeError, OSError) as error:
        raise ValueError(f"a .sog file that is damaged: {error}") from None


def images_in(folder: Path) -> list[Path]:
    """The images next to a meta.json."""
    return list(folder.glob("*.webp"))


def _in_archive(archive: zipfile.ZipFile, name: str) -> tuple[int, Callable[[], bytes]]:
    size = archive.getinfo(name).file_size
    # The member may hold more than is declared, and read() would unpack all of it.
    return size, partial(archive.open(name).read, size)


def _in_folder(folder: Path, name: str) -> tuple[int, Callable[[], bytes]]:
    if PurePosixPath(name).name != name or not (folder / name).is_file():
        raise ValueError(f"{META} names {name[:80]!r}, which is no file next to it")
    return (folder / name).stat().st_size, (folder / name).read_bytes


def _decode(text: bytes, size: int, files: Open) -> PlyTable:
    """The columns of splats whose files have ``size`` bytes in all."""
    meta = json.loads(text)
    if not isinstance(meta, dict) or "means" not in meta:
        raise ValueError("a JSON file that describes no splats")
    version = meta.get("version", 1)
    if version not in (1, VERSION):
        raise ValueError(f"a .sog file of version {version}; 1 and 2 are read")
    count = int(meta["count"] if version > 1 else meta["means"]["shape"][0])
    check_declared(PIXELS_OF_SPLAT * 4 * count, size)

    def pixels(part: str, number: int = 0, whole: bool = False) -> npt.NDArray[np.int64]:
        most = max(2 * count, LARGEST_PALETTE)
        image = _image(files, meta[part]["files"][number], most)
        if whole:
            return np.asarray(image, np.int64)
        rows = image.reshape(-1, 4)
        if not 0 <= count <= len(rows):
            raise ValueError(f"a .sog file of {count} splats, of which {part} holds {len(rows)}")
        return np.asarray(rows[:count], np.int64)

    def table(part: str) -> Floats:
        """256 numbers for each channel, (256, 1 or more)."""
        if version == 1:
            low, high = (np.array(meta[part][end], np.float64).ravel() for end in ("mins", "maxs"))
            return np.linspace(low, high, 256)
        book = np.asarray(meta[part]["codebook"], np.float64)
        if book.ndim != 1 or len(book) < 1:
            raise ValueError(f"a .sog file without a codebook of {part}")
        return np.pad(book, (0, max(0, 256 - len(book))), mode="edge")[:, None]

    steps = pixels("means", 0)[:, :3] + 256 * pixels("means", 1)[:, :3]
    least, most = (np.array(meta["means"][end], np.float64).reshape(3) for end in ("mins", "maxs"))
    logs = least + np.where(most > least, most - least, 1.0) * (steps / COORDINATE_STEPS)
    position = np.sign(logs) * np.expm1(np.abs(logs))
    scale = _look_up(table("scales"), pixels("scales")[:, :3])
    turned, first = pixels("quats"), pixels("sh0")
    small = (turned[:, :3] / 255.0 - 0.5) * np.sqrt(2)
    rotation = from_smallest_three(np.clip(turned[:, 3] - ROTATION_TAG, 0, 3), small)
    base = table("sh0")
    color = _look_up(base, first[:, :3])
    found = {axis: position[:, i] for i, axis in enumerate("xyz")}
    found |= {f"f_dc_{i}": color[:, i] for i in range(3)}
    if "shN" in meta:
        found |= _rest(meta["shN"], pixels, table("shN"))
    found["opacity"] = base[first[:, 3], 3] if version == 1 else logit(first[:, 3] / 255.0)
    found |= {f"scale_{i}": scale[:, i] for i in range(3)}
    found |= {f"rot_{i}": rotation[:, i] for i in range(4)}
    columns: dict[str, npt.NDArray[Any]] = {
        name: column if name in "xyz" else column.astype(np.float32)
        for name, column in found.items()
    }
    antialiased = meta.get("model") == MODEL or meta.get("antialias") is True
    asset = meta.get("asset")
    world = asset.get("world") if isinstance(asset, dict) else None
    comments = [*["antialiased 1"] * antialiased, *([world] if isinstance(world, str) else [])]
    return PlyTable(columns, comments)


def _look_up(table: Floats, pixels: npt.NDArray[np.int64]) -> Floats:
    """The numbers (..., 3) of a table at bytes (..., 3), channel by channel."""
    return np.asarray(table[pixels, np.arange(3) % table.shape[1]])


def _rest(meta: dict[str, Any], pixels: Any, table: Floats) -> dict[str, Floats]:
    """The columns f_rest_* of the palette."""
    centroids, labels = pixels("shN", 0, whole=True), pixels("shN", 1)
    # Version 1 names neither degree nor length; the image has a set's width for each column.
    degree = int(meta.get("bands", np.sqrt(1 + centroids.shape[1] // PALETTE_COLUMNS) - 1))
    entries = int(meta.get("count", len(centroids) * PALETTE_COLUMNS))
    if not 1 <= degree <= MAX_DEGREE:
        raise ValueError(f"a .sog file with {degree} bands of coefficients")
    width = (degree + 1) ** 2 - 1
    label = labels[:, 0] + 256 * labels[:, 1]
    sets = centroids[:, : PALETTE_COLUMNS * width, :3]
    if sets.shape[1] != PALETTE_COLUMNS * width or entries > len(sets) * PALETTE_COLUMNS:
        raise ValueError("a .sog file whose palette is smaller than it says")
    if (label >= entries).any():
        raise ValueError("a .sog file that points behind its palette")
    values = _look_up(table, sets.reshape(-1, width, 3)[label])
    return {f"f_rest_{width * c + i}": values[:, i, c] for c in range(3) for i in range(width)}


def _image(files: Open, name: str, most: int) -> npt.NDArray[np.uint8]:
    """The pixels (H, W, 4) of an image, ``most`` of them."""
    from PIL import Image, UnidentifiedImageError

    size, read = files(name)
    if size > 4 * most + SMALL:
        raise ValueError(f"{name} in a .sog file is larger than any image")
    try:
        with Image.open(io.BytesIO(read())) as image:
            if image.width * image.height > most:
                wide = f"{image.width}x{image.height}"
                raise ValueError(f"{name} in a .sog file is {wide}, too large for its splats")
            return np.asarray(image.convert("RGBA"))
    except (UnidentifiedImageError, OSError, Image.DecompressionBombError) as error:
        raise ValueError(f"{name} in a .sog file is damaged: {error}") from None
