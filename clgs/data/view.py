"""A photo with its camera, as training and scoring take it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain

from clgs.data.masks import Mask, StoredMask
from clgs.data.stored_photo import Color, Planes, StoredPhoto
from clgs.scene.camera import Camera


@dataclass(frozen=True)
class View:
    """One photo, undistorted and reduced, and its camera in scene units.

    ``photo.pixels()`` has the pixels: color (H, W, 3) uint8, and alpha (H, W) uint8 or None; mask
    says which of them are compared with renders, all if it is None.
    """

    name: str
    camera: Camera
    photo: StoredPhoto
    mask: StoredMask | None = None

    def used(self, factor: int = 1) -> Mask | None:
        """The mask (H, W) uint8 of 0 and 1, ``factor`` times smaller; None: every pixel is used.

        Raises:
            DataError: it is damaged.
        """
        return None if self.mask is None else self.mask.used(factor)


def with_photos(views: Sequence[View], color: Color) -> Iterator[tuple[View, Planes]]:
    """Each view with its photo over ``color``, (3, H, W) uint8.

    Each is read while the one before it is in use, and none is kept.

    Raises:
        DataError: a photo is damaged.
    """
    with ThreadPoolExecutor(1, "photos") as pool:
        coming = (pool.submit(view.photo.planes, color) for view in views)
        waiting = next(coming, None)
        for view, following in zip(views, chain(coming, [None]), strict=False):
            assert waiting is not None
            planes, waiting = waiting.result(), following
            yield view, planes
