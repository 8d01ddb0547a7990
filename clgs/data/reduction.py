"""Which photos training and scoring see: how large, held out or not, what their masks mean."""

from __future__ import annotations

from dataclasses import dataclass

VIEWS = 10.0, 160.0
"""Degrees that the undistorted picture of a fisheye may be asked to show: least and most."""

IGNORE, OBJECT = MEANINGS = ("ignore", "object")
"""What is where a photo is masked: anything, so that nothing is compared; or nothing at all."""

EVERY = 8
"""Every photo of this number is held out, unless something else is asked for."""

MAX_SIZE = 1600
"""Pixels; wider photos are reduced to this width, as the reference code of 3DGS does."""

LEAST_SIZE = 16
"""Pixels; no narrower width can be asked for: such photos show nothing that can be learned."""


@dataclass(frozen=True)
class Reduction:
    """What photos are reduced by, after the distortion was taken out.

    times: both sides by this number; 0: by none, but photos wider than ``max_size`` pixels are
    reduced to that width; max_size 0: they stay as they are, too.
    """

    times: int = 0
    max_size: int = MAX_SIZE

    def size(self, width: int, height: int) -> tuple[int, int]:
        """(width, height) that a photo of ``width`` x ``height`` pixels gets."""
        if self.times:
            return max(1, round(width / self.times)), max(1, round(height / self.times))
        if 0 < self.max_size < width:
            return self.max_size, max(1, round(height * self.max_size / width))
        return width, height


DEFAULT = Reduction()
