"""The box of the anchors that learn, if not all do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from clgs.errors import UsageError
from clgs.quantities import number

if TYPE_CHECKING:  # options import no arrays
    import numpy as np
    import numpy.typing as npt

REMEDY = "give six numbers x0,y0,z0,x1,y1,z1, such as -1,-1,-1,1,1,1; inf is a side without end"


@dataclass(frozen=True)
class Box:
    """Positions from ``low`` (3) to below ``high`` (3), scene units."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    def holds(self, position: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
        """Which of ``position`` (n, 3) are inside, (n,); NaN is not."""
        import numpy as np

        wide = position.astype(np.float64)
        return np.asarray(((wide >= self.low) & (wide < self.high)).all(axis=1))

    def text(self) -> str:
        """The box as the setting ``box`` has it: :func:`parse_box` gives the same numbers."""
        return ",".join(map(repr, (*self.low, *self.high)))


def parse_box(text: str) -> Box:
    """The box that the setting ``box`` describes.

    Raises:
        UsageError: not six numbers, or a side without length.
    """
    sides = [number(word) for word in text.split(",")]
    if len(sides) != 6 or None in sides:
        raise UsageError(f"box: {text[:60]!r} is no box; {REMEDY}")
    found = [float(side) for side in sides if side is not None]
    if not all(low < high for low, high in zip(found[:3], found[3:], strict=True)):
        raise UsageError(f"box: {text[:60]!r} has a side without length; {REMEDY}")
    return Box(tuple(found[:3]), tuple(found[3:]))
