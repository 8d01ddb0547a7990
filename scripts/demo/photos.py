"""Photographs of the demonstration's scene, taken by a visitor who walks three arcs around it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from PIL import Image
from raytrace import RayScene, View
from scene import build

from clgs.errors import DataError
from clgs.files import atomic_path

WIDTH, HEIGHT = 400, 300
FOCAL_PER_WIDTH = 1.0
"""Focal length in picture widths: a field of view of 53 degrees. Nobody tells SfM."""

ELEVATIONS = (28.0, 13.0, 42.0)
"""Degrees of the arcs, in the order in which they are walked."""

STOPS = 16
"""Photos an arc: about 7 degrees apart, well within reach of SIFT."""

ARC = (-97.0, 7.0)
"""Azimuths in degrees between which the arcs run; the corner is seen at -45."""

DISTANCE, TARGET = 4.6, (-0.1, 0.1, 0.7)
JITTER_DEGREES, JITTER_METRES = 1.2, 0.12
QUALITY = 95


def views(seed: int, width: int = WIDTH) -> Iterator[View]:
    """Where the photos are taken: arc after arc, there and back, held by a mildly shaky hand."""
    rng = np.random.default_rng(seed)
    for arc, elevation in enumerate(ELEVATIONS):
        first, last = ARC if arc % 2 == 0 else ARC[::-1]
        for azimuth in np.linspace(first, last, STOPS):
            angles = np.radians([azimuth, elevation] + rng.uniform(-1, 1, 2) * JITTER_DEGREES)
            (cos_a, cos_e), (sin_a, sin_e) = np.cos(angles), np.sin(angles)
            offset, *aim = rng.uniform(-1, 1, 4) * JITTER_METRES
            direction = np.array([cos_a * cos_e, sin_a * cos_e, sin_e])
            target = np.array(TARGET)
            place = target + (DISTANCE + offset) * direction
            height = width * HEIGHT // WIDTH
            yield View.looking(place, target + aim, FOCAL_PER_WIDTH * width, width, height)


def require_tracer() -> None:
    """Make sure that embree is there.

    Raises:
        DataError: it is not, as on platforms for which embreex publishes no wheel.
    """
    if find_spec("embreex") is None:
        raise DataError(
            "embreex is not installed (pip install 'clgs[demo]'; it has no wheel on some "
            "platforms), so the demo cannot make its own photos; pass a folder of yours: "
            "./scripts/demo.sh PHOTOS"
        )


@cache
def _scene() -> RayScene:
    """Built once a process."""
    return build()


def take(view: View, path: Path) -> None:
    """One photo, as a plain JPEG without any EXIF."""
    picture = Image.fromarray(_scene().render(view))
    with atomic_path(path) as temporary:
        picture.save(temporary, quality=QUALITY, subsampling=0)


def make_photos(folder: Path, seed: int = 0, width: int = WIDTH, stops: int | None = None) -> int:
    """Photograph the scene into ``folder`` on all cores; the same seed gives the same files.

    stops: number of photos, from the first; default all. Returns the number of photos.

    Raises:
        DataError: embreex is missing.
    """
    require_tracer()
    folder.mkdir(parents=True, exist_ok=True)
    todo = list(views(seed, width))[:stops]
    paths = [folder / f"photo_{index:03d}.jpg" for index in range(len(todo))]
    # Fresh processes: a fork could inherit the locks of a library's threads.
    with ProcessPoolExecutor(min(os.cpu_count() or 1, 8), get_context("spawn")) as pool:
        for _ in pool.map(take, todo, paths):
            pass
    return len(paths)
