"""RealityScan's (RealityCapture's) CSV of internal and external camera parameters.

Heading, pitch and roll are those of the camera in OpenGL's axes: turns by -heading about z, by
pitch about x, by roll about y. The focal length is for a film of 36 mm, the principal point is
relative to the middle, in units of the longer side. Sources: "RealityCapture XMP camera math" of
its makers, and the columns' use by other programs that read the file.
"""

from __future__ import annotations

import csv
import logging
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from functools import partial
from pathlib import Path

import numpy as np

from clgs.data.lens import Lens
from clgs.data.posed_photo import ListedPhoto, PhotoSet
from clgs.data.programs.listing import FROM_OPENGL, checked, number, photo_set, pose
from clgs.errors import DataError
from clgs.scene.world import frame_of

KIND = "realityscan"

FILM = 36.0
"""Millimetres that the longer side of a photo takes on the film of the focal length."""

NEEDED = "name", "x", "y", "alt", "heading", "pitch", "roll", "f"
RADIAL = "k1", "k2", "k3", "k4"
HEADER = re.compile(r"\s*#\s*name\s*([,;\t])\s*x\s*\1\s*y\s*\1", re.IGNORECASE)
"""Begins the line that names the columns; which sign separates them."""
MAX_BYTES = 64 * 2**20

_log = logging.getLogger(__name__)


def find(root: Path) -> Path | None:
    """The CSV file of cameras in a folder, the first by name."""
    for path in filter(Path.is_file, sorted(root.glob("*.[cC][sS][vV]"))):
        with path.open("rb") as file:
            start = file.read(4096)
        lines = start.decode(_encoding(start), errors="ignore").splitlines()
        if any(HEADER.match(line) for line in lines[:2]):
            return path
    return None


def _encoding(start: bytes) -> str:
    """How a file that begins with these bytes is written; spreadsheets save UTF-16."""
    return "utf-16" if start.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "utf-8-sig"


def read(root: Path, file: Path) -> PhotoSet:
    """The cameras of a CSV file, and the point cloud next to it if there is one PLY file.

    Raises:
        DataError: names file, line, column and remedy.
    """
    from scipy.spatial.transform import Rotation  # 0.2 s, 30 MB: only where it is needed

    listed = []
    for line, row in _rows(file):
        source = f"{file}: line {line}"
        heading, pitch, roll, *centre = (
            number(row, name, source) for name in ("heading", "pitch", "roll", "x", "y", "alt")
        )
        turn = Rotation.from_euler("ZXY", [-heading, pitch, roll], degrees=True)
        rotation, translation = pose(turn.as_matrix() * FROM_OPENGL, np.array(centre), source)
        lens = partial(_lens, row, source)
        lens(1, 1)  # a bad file is bad on every machine, even if the photo is missing
        listed.append(ListedPhoto(row["name"], source, rotation, translation, None, lens))
    found = photo_set(KIND, root, file, listed)
    found.frame = frame_of(np.array([photo.centre for photo in found.train + found.test]))
    clouds = sorted(root.glob("*.[pP][lL][yY]"))
    found.points_file = clouds[0] if len(clouds) == 1 else None
    if len(clouds) > 1:
        _log.warning("%s: %d PLY files; name one with --points", root, len(clouds))
    return found


def _rows(file: Path) -> list[tuple[int, dict[str, str]]]:
    """The lines of cameras with their numbers, by the names of the columns."""
    if file.stat().st_size > MAX_BYTES:
        raise DataError(f"{file}: larger than {MAX_BYTES >> 20} MiB; export fewer cameras")
    data = file.read_bytes()
    try:
        lines = data.decode(_encoding(data)).splitlines()
    except UnicodeDecodeError:
        raise DataError(
            f"{file}: is neither UTF-8 nor UTF-16; export the camera parameters again"
        ) from None
    start, header = next(
        (i, found) for i, line in enumerate(lines) if (found := HEADER.match(line))
    )
    separator = header[1]
    columns = [name.strip().lower() for name in lines[start].strip()[1:].split(separator)]
    if lacking := [name for name in NEEDED if name not in columns]:
        raise DataError(
            f"{file}: has no column {lacking[0]}; export 'Internal/External camera parameters'"
        )
    try:
        below = list(csv.reader(lines[start + 1 :], delimiter=separator))
    except csv.Error as error:
        raise DataError(f"{file}: {error}; export the camera parameters again") from None
    rows = []
    for place, values in enumerate(below, start + 2):
        if not values or values[0].startswith("#"):
            continue
        if len(values) != len(columns):
            raise DataError(
                f"{file}: line {place}: {len(values)} values for {len(columns)} columns; export "
                "it again"
            )
        row = dict(zip(columns, map(str.strip, values), strict=True))
        if separator == ";":  # of spreadsheets in languages whose decimal mark is the comma
            row |= {name: text.replace(",", ".") for name, text in row.items() if name != "name"}
        rows.append((place, row))
    return rows


def _lens(row: dict[str, str], source: str, width: int, height: int) -> Lens:
    longer = max(width, height)
    focal = number(row, "f", source) / FILM * longer
    x, y = (longer * number(row, name, source, 0.0) for name in ("px", "py"))
    t1, t2 = (number(row, name, source, 0.0) for name in ("t1", "t2"))
    radial = tuple(number(row, name, source, 0.0) for name in RADIAL)
    place = width / 2 + x, height / 2 + y
    return checked(Lens(width, height, focal, focal, *place, radial, (), (t1, t2)), source)
