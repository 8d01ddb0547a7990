"""Cameras of all programs: which program made those in a folder, and its reader."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from clgs.data.colmap_model import find_model, read_colmap
from clgs.data.posed_photo import PhotoSet
from clgs.data.programs import metashape, opendronemap, phones, realityscan
from clgs.data.transforms import BLENDER, TRANSFORMS, read_blender, read_transforms
from clgs.files import in_any_case


def _find(name: str, root: Path) -> Path | None:
    file = in_any_case(root / name)
    return file if file.is_file() else None


FORMATS = (
    (partial(_find, BLENDER), read_blender),
    (partial(_find, TRANSFORMS), read_transforms),
    (find_model, read_colmap),
    (metashape.find, metashape.read),
    (realityscan.find, realityscan.read),
    (opendronemap.find, opendronemap.read),
    (phones.find_polycam, phones.read_polycam),
    (phones.find_record3d, phones.read_record3d),
)
"""What finds the file or folder of cameras in a folder, and what reads the photos by that."""

FILES = {".xml": metashape.read, ".csv": realityscan.read}
"""What reads a file whose photos need not lie next to it, by its suffix."""


def find_reader(root: Path) -> Callable[[], PhotoSet] | None:
    """What reads the data set in ``root``; None if no program's cameras are there."""
    if not root.is_dir():
        return None
    for find, read in FORMATS:
        file = find(root)
        if file is not None:
            return partial(read, root, file)
    return None
