"""Photos with poses as what JSON can hold, exactly: they pass to child processes so."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from clgs.data.lens import Lens
from clgs.data.posed_photo import Photo


def to_plain(photo: Photo) -> dict[str, Any]:
    """Convert a photo to texts, numbers and lists."""
    arrays = {"rotation": photo.rotation.tolist(), "translation": photo.translation.tolist()}
    mask = None if photo.mask is None else str(photo.mask)
    files = {"path": str(photo.path), "mask": mask}
    return {"name": photo.name, "lens": asdict(photo.lens), **files, **arrays}


def from_plain(plain: dict[str, Any]) -> Photo:
    """Make a photo of what :func:`to_plain` returned."""
    lens: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in plain["lens"].items()
    }
    rotation, translation = (
        np.array(plain[name], np.float64) for name in ("rotation", "translation")
    )
    mask = None if plain["mask"] is None else Path(plain["mask"])
    return Photo(plain["name"], Path(plain["path"]), Lens(**lens), rotation, translation, mask)
