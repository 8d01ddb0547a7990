"""Growing and pruning anchor by anchor, in float64: what ``clgs.ops.growth`` does in place.

Here hidden anchors are rows of NaN positions, too.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]


def hide_undrawn(
    position: Array, offset: Array, counts: tuple[Integers, Integers], seen: tuple[Integers, Array]
) -> None:
    """Change position (A, 3), offset (A, K, 3) and counts: visits (A,), gradient_count (A, K).

    ``seen``: visible (V,), and opacities (K, V) of which those above 0 are drawn.
    """
    for column, anchor in enumerate(seen[0]):
        if anchor < 0:
            continue
        drawn = [bool(seen[1][j, column] > 0) for j in range(K_OFFSETS)]
        for j in range(K_OFFSETS):
            if not drawn[j]:
                offset[anchor, j] = 0.0
        if not any(drawn):
            hide(position, counts, np.array([anchor], np.int32))


def hide(position: Array, counts: tuple[Integers, Integers], rows: Integers) -> None:
    """Change position (A, 3) and counts: visits (A,), gradient_count (A, K)."""
    for row in rows:
        position[row] = np.nan
        for count in counts:
            count[row] = 0


def places(offset: Array, scaling: Array, slots: Integers) -> Array:
    """(n, 6): offset of a slot, and the first three scalings of its anchor."""
    rows = [(*offset[s // K_OFFSETS, s % K_OFFSETS], *scaling[s // K_OFFSETS, :3]) for s in slots]
    return np.array(rows).reshape(len(slots), 6)


def restart(gradient_sum: Array, gradient_count: Integers, seen: int) -> None:
    """Zero both (A, K) at slots that were seen more often than ``seen`` times."""
    for place in np.ndindex(gradient_count.shape):
        if gradient_count[place] > seen:
            gradient_sum[place], gradient_count[place] = 0.0, 0


def prune(
    anchors: tuple[Array, Array],
    sums: tuple[Array, Integers, Integers],
    visits: int,
    least_opacity: float,
    most_scaling: float,
) -> list[int]:
    """Change position (A, 3), scaling (A, 6), opacity_sum (A,) and counts; rows that are hidden."""
    (position, scaling), (opacity_sum, *counts) = anchors, sums
    gone = []
    for row in range(len(position)):
        for i in range(3, 6):
            scaling[row, i] = min(scaling[row, i], most_scaling)
        if counts[0][row] <= visits:
            continue
        if opacity_sum[row] < least_opacity * counts[0][row]:
            hide(position, (counts[0], counts[1]), np.array([row], np.int32))
            gone.append(row)
        opacity_sum[row], counts[0][row] = 0.0, 0
    return gone


def asking(gradient_sum: Array, gradient_count: Integers, seen: int, least: float) -> list[int]:
    """Slots of (A, K) seen more often than ``seen`` times, with a sum of ``least`` per time."""
    pairs = zip(gradient_sum.ravel(), gradient_count.ravel(), strict=True)
    return [slot for slot, (x, times) in enumerate(pairs) if times > seen and x >= least * times]


def features(feature: Array, first: Integers, parents: Integers) -> Array:
    """(N, F) of new anchors: the maximum over parents[first[i] : first[i + 1]], by channel."""
    parts = [parents[first[i] : first[i + 1]] for i in range(len(first) - 1)]
    return np.array([feature[part].max(axis=0) for part in parts]).reshape(-1, feature.shape[1])
