"""The photos with poses in a folder, by whichever of three formats the folder holds."""

from __future__ import annotations

import shlex
from pathlib import Path

from clgs.data.colmap.model import find_model, read_colmap
from clgs.data.images import list_images
from clgs.data.masks import list_masks
from clgs.data.posed_photo import PhotoSet
from clgs.data.transforms import read_blender, read_transforms
from clgs.errors import DataError

BLENDER, TRANSFORMS = "transforms_train.json", "transforms.json"
"""The files that mark a Blender folder and one of nerfstudio or instant-ngp."""


def is_posed(folder: Path) -> bool:
    """Whether ``folder`` is a data set with poses."""
    marked = any((folder / name).is_file() for name in (BLENDER, TRANSFORMS))
    return marked or find_model(folder) is not None


def read_photo_set(root: Path) -> PhotoSet:
    """The photos with poses in ``root``; no picture is decoded.

    Raises:
        DataError: no data set, or a damaged one.
    """
    if not root.is_dir() or not is_posed(root):
        raise DataError(f"{root}: {_why_none(root)}")
    if (root / BLENDER).is_file():
        return read_blender(root)
    model = None if (root / TRANSFORMS).is_file() else find_model(root)
    found = read_transforms(root) if model is None else read_colmap(root, model)
    everyone = found.train + found.test
    used = {photo.mask for photo in everyone} | {photo.path for photo in everyone}
    folders = sorted({photo.path.parent for photo in everyone})
    masks = dict.fromkeys(mask for folder in folders for mask in list_masks(root, folder))
    found.stray_masks = [mask.relative_to(root).as_posix() for mask in masks if mask not in used]
    return found


def _why_none(root: Path) -> str:
    """What ``root``, which is no data set, is instead, and what to do."""
    if root.is_file():
        return "is a file; name the folder of the data set"
    if not root.is_dir():
        return "no such folder; check the path"
    if (root / "config.toml").is_file():
        return "is a run, no data set; name the photos that it was trained on"
    above = next(filter(is_posed, list(root.absolute().parents)[:2]), None)
    if above is not None:
        return f"is a part of a data set; name the whole of it: {above}"
    if any(list_images(folder) for folder in (root, root / "images") if folder.is_dir()):
        return f"photos without poses; run: clgs prepare {shlex.quote(str(root))} -o DATA"
    return "no transforms.json, transforms_train.json, COLMAP model or photos; check the path"
