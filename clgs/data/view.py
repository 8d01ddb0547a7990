"""A photo with its camera, as training and scoring take it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain

from clgs.data.masks import Mask, StoredMask
from clgs.data.reduction import IGNORE, OBJECT
from clgs.data.stored_photo import Color, Planes, StoredPhoto
from clgs.scene.camera import Camera


@dataclass(frozen=True)
class View:
    """One photo, undistorted and reduced, and its camera in scene units.

    ``photo.pixels()`` has the pixels: color (H, W, 3) uint8, and alpha (H, W) uint8 or None; mask
    says which of them are of use, all if it is None. If ``masks`` is "ignore", the others are not
    compared with renders; if it is "object", the photo's alpha is 0 there and all are compared.
    """

    name: str
    camera: Camera
    photo: StoredPhoto
    mask: StoredMask | None = None
    masks: str = IGNORE

    def used(self, factor: int = 1) -> Mask | None:
        """The pixels to compare, (H, W) uint8 of 0 and 1, ``factor`` times smaller; None: all.

        Raises:
            DataError: it is damaged.
        """
        if self.mask is None or self.masks == OBJECT:
            return None
        return self.mask.used(factor)


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
