"""The photos of a reconstruction: under numbers while pycolmap works, under their names after."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from clgs.data.images import image_size
from clgs.poses.photos.cameras import camera_numbers


@dataclass(frozen=True)
class Shot:
    """A photo to be placed.

    file: its number, as pycolmap reads it; name: its own, relative, with forward slashes; camera:
    equal for photos that share focal length and distortion; size: longer side in pixels.
    """

    file: str
    name: str
    camera: int
    size: int


def list_shots(images: Path) -> list[Shot]:
    """All photos in and below a folder, by name.

    Raises:
        DataError: one is damaged.
    """
    paths = sorted(path for path in images.rglob("*") if path.is_file())
    cameras = camera_numbers(paths)
    return [
        Shot(
            f"{number:06d}{path.suffix.lower()}",
            path.relative_to(images).as_posix(),
            camera,
            max(image_size(path)),
        )
        for number, (path, camera) in enumerate(zip(paths, cameras, strict=True))
    ]


def number_files(shots: list[Shot], named: Path, numbered: Path) -> None:
    """Move the photos to a new folder, under their numbers: names may hold spaces and folders."""
    numbered.mkdir()
    for shot in shots:
        (named / shot.name).rename(numbered / shot.file)


def name_files(shots: list[Shot], numbered: Path, named: Path) -> None:
    """Move them back."""
    for shot in shots:
        (numbered / shot.file).rename(named / shot.name)


def number_masks(shots: list[Shot], named: Path, numbered: Path) -> Path | None:
    """Masks under the numbers of their photos, as NAME.png, in a new folder; None without any."""
    if not named.is_dir():
        return None
    numbered.mkdir()
    for shot in shots:
        shutil.copyfile(named / f"{shot.name}.png", numbered / f"{shot.file}.png")
    return numbered
