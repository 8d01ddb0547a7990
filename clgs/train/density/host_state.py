"""All that has a row per anchor, on the host: for rounds that judge anchors, and for merging.

Rows keep their order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.errors import ClgsError
from clgs.ops.density import Statistics
from clgs.scene.anchors import AnchorSet
from clgs.train.density.cells import Grid, voxels_of
from clgs.train.state.parameters import Moments

NOTHING_LEFT = (
    "pruning left no anchors: nothing is opaque in any view; "
    "check the images and poses, or lower the learning rates"
)


@dataclass
class TrainState:
    """Everything that has a row per anchor: anchors, statistics and Adam's moments.

    moments: of ``parameters.ANCHOR_GROUPS``, shaped as those are.
    """

    anchors: AnchorSet
    statistics: Statistics[npt.NDArray[Any]]
    moments: dict[str, Moments]


def merge_cells(state: TrainState, q_position: float) -> int:
    """Move anchors to the grid of ``q_position`` cells a scene unit; returns how many merged away.

    Of the anchors of a cell the one with the largest summed opacity stays, with its moments; the
    first one in case of a tie. Positions become float32(integer / q_position).

    Raises:
        ClgsError: the grid is too fine for the extent of the anchors.
    """
    cells = voxels_of(state.anchors.position, q_position)
    keys = Grid.around(cells).keys(cells)
    order = np.lexsort((-state.statistics.opacity_sum, keys))
    first = np.ones(len(order), np.bool_)
    first[1:] = keys[order[1:]] != keys[order[:-1]]
    keep = np.zeros(len(order), np.bool_)
    keep[order[first]] = True
    merged = keep_rows(state, keep)
    position = (cells[:, keep].T / np.float64(q_position)).astype(np.float32)
    state.anchors = replace(state.anchors, position=position)
    return merged


def keep_rows(state: TrainState, keep: npt.NDArray[np.bool_]) -> int:
    """Drop the other rows of the whole state; returns how many.

    Raises:
        ClgsError: nothing is left.
    """
    rows = np.flatnonzero(keep)
    if not len(rows):
        raise ClgsError(NOTHING_LEFT)
    if len(rows) < len(keep):
        state.anchors = state.anchors.map(lambda array: array.take(rows, axis=0))
        _replace_records(state, lambda array: array.take(rows, axis=0))
    return len(keep) - len(rows)


def _replace_records(
    state: TrainState, change: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]
) -> None:
    """Apply ``change`` to every array of the statistics and moments, one at a time."""
    state.statistics = state.statistics.map(change)
    state.moments = {name: moments.map(change) for name, moments in state.moments.items()}
