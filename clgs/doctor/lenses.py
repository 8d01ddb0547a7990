"""Intrinsics: distortion, principal point, focal length."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clgs.data.lens import Lens, undistort_lens
from clgs.data.posed_photo import Photo
from clgs.doctor.finding import ERROR, NOTE, WARNING, Finding, named
from clgs.errors import DataError

OFF_CENTRE = 0.1
"""Of the width or height; a principal point further from the middle means a cropped photo."""

LOST = 0.25
"""Share of the pixels that are lost when the distortion is taken out, above which to warn."""

UNEVEN = 0.02
"""Pixels whose sides differ by more are rare."""

FIELD_OF_VIEW = 10.0, 140.0
"""Degrees across that photos usually have."""


Fault = tuple[str, str, str]
"""Level, problem, remedy."""


def check_lenses(photos: list[Photo]) -> Iterator[Finding]:
    """One finding for each fault: the photos that have it, and what the first of them has."""
    found: dict[tuple[str, str], tuple[str, list[str]]] = {}
    known: dict[Lens, list[Fault]] = {}
    for photo in photos:
        if photo.lens not in known:
            known[photo.lens] = [*_distortion(photo.lens), *_centre(photo.lens)]
            known[photo.lens] += _focal(photo.lens)
        for level, problem, remedy in known[photo.lens]:
            found.setdefault((level, remedy), (problem, []))[1].append(photo.name)
    lenses: dict[str, Lens] = {photo.name: photo.lens for photo in photos}
    for (level, remedy), (problem, names) in found.items():
        alike = len({lenses[name] for name in names}) > 1
        yield Finding(level, named(names), problem + " (the first)" * alike, remedy)


def _distortion(lens: Lens) -> Iterator[Fault]:
    if not lens.distorted:
        return
    try:
        pinhole, _ = undistort_lens(lens)
    except DataError as error:
        yield ERROR, str(error), "correct k1, k2, p1, p2, or calibrate again"
        return
    lost = 1.0 - pinhole.width * pinhole.height / (lens.width * lens.height)
    kind = "a fisheye" if lens.fisheye else "a distorted lens"
    problem = f"{kind}: {pinhole.width}x{pinhole.height} of {lens.width}x{lens.height} remain"
    if lost > LOST:
        yield WARNING, problem, "check k1, k2, p1, p2: so much is rarely lost"
    else:
        yield NOTE, problem, "nothing to do: it is taken out when photos are read"


def _centre(lens: Lens) -> Iterator[Fault]:
    off = max(abs(lens.cx / lens.width - 0.5), abs(lens.cy / lens.height - 0.5))
    if off > OFF_CENTRE:
        problem = f"principal point ({lens.cx:.1f}, {lens.cy:.1f}) of {lens.width}x{lens.height}"
        remedy = "correct cx, cy; they go with w, h of the same photo, and cropping moves them"
        yield WARNING, f"{problem} is {off:.0%} off the middle", remedy


def _focal(lens: Lens) -> Iterator[Fault]:
    angle = float(np.degrees(2 * np.arctan(lens.width / (2 * lens.fx))))
    least, most = FIELD_OF_VIEW
    if not (least <= angle <= most) and not lens.fisheye:
        problem = f"focal length {lens.fx:.1f} pixels, that is {angle:.1f} degrees across"
        yield WARNING, problem, "correct fl_x; it goes with w of the same photo"
    if abs(lens.fx / lens.fy - 1.0) > UNEVEN:
        problem = f"fx is {lens.fx:.1f} and fy {lens.fy:.1f}: pixels are not square"
        yield WARNING, problem, "correct them, unless the photo was stretched"
