"""The setting of the box in which anchors learn."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clgs.errors import UsageError
from clgs.quantities import number

if TYPE_CHECKING:
    from clgs.scene.region import Box

REMEDY = "give six numbers x0,y0,z0,x1,y1,z1, such as -1,-1,-1,1,1,1; inf is a side without end"


def parse_box(text: str) -> Box:
    """The box that the setting ``box`` describes, in scene units.

    Raises:
        UsageError: not six numbers, or a side without length.
    """
    from clgs.scene.region import Box  # imports NumPy, which help does not need

    sides = [number(word) for word in text.split(",")]
    if len(sides) != 6 or None in sides:
        raise UsageError(f"box: {text[:60]!r} is no box; {REMEDY}")
    x0, y0, z0, x1, y1, z1 = (float(side) for side in sides if side is not None)
    try:
        return Box((x0, y0, z0), (x1, y1, z1))
    except UsageError as error:
        raise UsageError(f"{error}; {REMEDY}") from None
