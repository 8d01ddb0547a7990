"""Cameras that are far from the others: most often their poses are wrong."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

LEAST = 5
"""Fewer cameras do not show what is usual."""

APART, ASTRAY = 5.0, 20.0
"""Multiples of the median distance from the middle of all cameras. Beyond the first a camera is
worth a look; beyond the second no capture has cameras.
"""

ALONE = 0.5
"""A lonely camera is at least this times its distance from the middle away from all others."""


def spread(centres: Floats) -> tuple[Floats, float]:
    """Distances (N,) of cameras from their median centre, and the median of these.

    Args:
        centres: (N, 3), N at least 1, world units.
    """
    distance = np.linalg.norm(centres - np.median(centres, axis=0), axis=1)
    return distance, float(np.median(distance))


def in_one_place(centres: Floats) -> bool:
    """Whether most cameras are at their median centre, so that photos show no depth."""
    _, usual = spread(centres)
    return not usual > 1e-9 * (1.0 + float(np.abs(centres).max()))


def apart(centres: Floats, times: float) -> npt.NDArray[np.bool_]:
    """Which cameras (N,) are more than ``times`` the median distance from the middle of all.

    None of fewer than LEAST cameras, nor of cameras that are mostly in one place.
    """
    distance, usual = spread(centres)
    enough = len(centres) >= LEAST and not in_one_place(centres)
    return np.asarray((distance > times * usual) & enough)


def lonely(centres: Floats) -> npt.NDArray[np.bool_]:
    """Which cameras (N,) are worth a look: far from the middle and from all others.

    A photographer who walks away from the others' place is never far from the previous photo.
    Cameras beyond ASTRAY count even if there are several of them.
    """
    distance, _ = spread(centres)
    found = apart(centres, APART)
    for i in np.flatnonzero(found):
        others = np.delete(centres, i, axis=0)
        found[i] = np.linalg.norm(others - centres[i], axis=1).min() > ALONE * distance[i]
    return found | apart(centres, ASTRAY)
