"""The photos of a reconstruction: under numbers while pycolmap works, under their names after."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from clgs.data.images import image_size, read_exif

_DETAILS = 0x8769
_CAMERA = (0x010F, 0x0110)  # maker, model
_FOCAL = (0x920A, 0xA405)  # focal length in mm, and its equivalent on 35 mm film


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


def camera_numbers(paths: list[Path]) -> list[int]:
    """A number for each photo, from 0; equal for photos of one size, camera and focal length.

    Raises:
        DataError: a photo is damaged.
    """
    numbers: dict[tuple[object, ...], int] = {}
    return [numbers.setdefault(_kind(path), len(numbers)) for path in paths]


def _kind(path: Path) -> tuple[object, ...]:
    size = image_size(path)
    with Image.open(path, formats=("JPEG", "PNG")) as picture:
        exif = read_exif(picture)
    details = exif.get_ifd(_DETAILS)
    named = [str(exif.get(tag, "")) for tag in _CAMERA]
    return (*size, *named, *(str(details.get(tag, "")) for tag in _FOCAL))
