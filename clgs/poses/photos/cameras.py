"""Which photos were taken by one camera at one focal length."""

from __future__ import annotations

from pathlib import Path

from clgs.data.images import open_image, read_exif, upright_size

_DETAILS = 0x8769
_CAMERA = (0x010F, 0x0110)  # maker, model
_FOCAL = (0x920A, 0xA405)  # focal length in mm, and its equivalent on 35 mm film


def camera_numbers(paths: list[Path]) -> list[int]:
    """A number for each photo, from 0; equal for photos of one size, camera and focal length.

    Raises:
        DataError: a photo is damaged.
    """
    numbers: dict[tuple[object, ...], int] = {}
    return [numbers.setdefault(_kind(path), len(numbers)) for path in paths]


def _kind(path: Path) -> tuple[object, ...]:
    with open_image(path) as picture:
        exif, size = read_exif(picture), upright_size(picture)
    details = exif.get_ifd(_DETAILS)
    named = [str(exif.get(tag, "")) for tag in _CAMERA]
    return (*size, *named, *(str(details.get(tag, "")) for tag in _FOCAL))
