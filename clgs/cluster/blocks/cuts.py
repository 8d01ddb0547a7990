"""Blocks of a scene: cuts along two axes of the grid of voxels, and who owns an anchor.

The first axis is cut into rows, and each row along the second one into columns of its own, so that
all blocks contribute about the same to the pictures. Cuts are half-integers: every position, an
integer of the grid, lies in exactly one block.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.errors import UsageError
from clgs.scene.region import Box

Integers = npt.NDArray[np.int32]
Weights = npt.NDArray[np.float64]

AUTO = "auto"

MOST_BLOCKS = 10_000

MARGIN = 0.1
"""Margin of a block, as a share of the mean length of blocks along that axis."""

BULK = (0.02, 0.98)
"""Shares of the contribution between which the length of a scene is measured: a few anchors are far
away."""


def parse_counts(text: str) -> tuple[int, int] | None:
    """(rows, columns) of NxM; None for AUTO.

    Raises:
        UsageError: neither, or a single block.
    """
    if text == AUTO:
        return None
    found = re.fullmatch(r"([0-9]{1,5})[x\u00d7]([0-9]{1,5})", text.strip().lower())
    rows, columns = (0, 0) if found is None else (int(found[1]), int(found[2]))
    if not rows * columns:
        raise UsageError(f"--blocks {text[:40]}: is not NxM, such as 2x2, nor {AUTO}")
    if rows * columns == 1:
        raise UsageError(f"--blocks {text}: is the whole scene; leave it out, or give more blocks")
    if rows * columns > MOST_BLOCKS:
        raise UsageError(f"--blocks {text}: at most {MOST_BLOCKS} blocks are possible")
    return rows, columns


@dataclass(frozen=True)
class Cuts:
    """Where a scene is cut, in integers of the grid of positions.

    axes: the axis across which rows follow each other, and that of columns; rows: cuts between
    rows; columns: of each row, the cuts between its columns; margin: around a block, along each of
    ``axes``.
    """

    axes: tuple[int, int]
    rows: tuple[float, ...]
    columns: tuple[tuple[float, ...], ...]
    margin: tuple[float, float]

    @property
    def names(self) -> list[str]:
        """ROW-COLUMN of every block; their order is that of all lists of blocks."""
        return [f"{row}-{column}" for row, column in self._places()]

    @property
    def counts(self) -> tuple[int, int]:
        """Rows, and columns of each."""
        return len(self.columns), len(self.columns[0]) + 1

    def owner(self, position: Integers) -> npt.NDArray[np.intp]:
        """The number of the block of each position (A, 3), (A,)."""
        first, second = self.axes
        row = np.searchsorted(self.rows, position[:, first])
        before, owner = 0, np.zeros(len(position), np.intp)
        for number, cuts in enumerate(self.columns):
            here = row == number
            owner[here] = before + np.searchsorted(cuts, position[here, second])
            before += len(cuts) + 1
        return owner

    def box(self, block: int, margin: bool) -> Box:
        """Block number ``block``, in integers of the grid, perhaps with its margin."""
        row, column = self._places()[block]
        lower, upper = [-math.inf] * 3, [math.inf] * 3
        places = ((self.rows, row), (self.columns[row], column))
        for axis, (cuts, place), around in zip(self.axes, places, self.margin, strict=True):
            edges = (-math.inf, *cuts, math.inf)
            lower[axis] = edges[place] - margin * around
            upper[axis] = edges[place + 1] + margin * around
        return Box((lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2]))

    def record(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        return {
            "axes": list(self.axes),
            "rows": list(self.rows),
            "columns": [list(cuts) for cuts in self.columns],
            "margin": list(self.margin),
        }

    @classmethod
    def restore(cls, record: Mapping[str, Any]) -> Cuts:
        """What gave ``record``; ValueError, TypeError or KeyError if nothing did."""
        first, second = map(int, record["axes"])
        across, along = map(float, record["margin"])
        columns = tuple(tuple(map(float, cuts)) for cuts in record["columns"])
        cuts = cls((first, second), tuple(map(float, record["rows"])), columns, (across, along))
        if len(columns) != len(cuts.rows) + 1 or {first, second} - {0, 1, 2}:
            raise ValueError("cuts and axes do not fit")
        return cuts

    def _places(self) -> list[tuple[int, int]]:
        """(row, column) of every block."""
        return [(r, c) for r, cuts in enumerate(self.columns) for c in range(len(cuts) + 1)]


def cut_scene(
    position: Integers, contribution: Weights, up: Weights, counts: tuple[int, int]
) -> Cuts:
    """Cuts of a scene into ``counts`` rows and columns of about equal contribution.

    Args:
        position: of the anchors, (A, 3), integers of their grid.
        contribution: of each anchor to all pictures, (A,), at least 0.
        up: (3,); the axis nearest to it is not cut.
        counts: rows across the longer of the others, and columns.

    Raises:
        UsageError: the anchors lie at too few places for these blocks.
    """
    weight = contribution + max(float(contribution.mean()), 1.0) * 1e-6
    first, second = long_axes(position, weight, up)
    lengths = [bulk(position[:, axis], weight) for axis in (first, second)]
    margin = [MARGIN * max(1.0, one / n) for one, n in zip(lengths, counts, strict=True)]
    rows = _cuts(position[:, first], weight, counts[0])
    row = np.searchsorted(rows, position[:, first])
    columns = tuple(
        _cuts(position[row == number, second], weight[row == number], counts[1])
        for number in range(counts[0])
    )
    return Cuts((first, second), rows, columns, (margin[0], margin[1]))


def long_axes(position: Integers, weight: Weights, up: Weights) -> tuple[int, int]:
    """The axes other than the one nearest to ``up``, the one along which anchors spread first."""
    flat = [axis for axis in range(3) if axis != int(np.argmax(np.abs(up)))]
    first, second = sorted(flat, key=lambda axis: -bulk(position[:, axis], weight))
    return first, second


def bulk(coordinate: Integers, weight: Weights) -> float:
    """The length that holds most of the weight (A,) along one axis, in cells."""
    order = np.argsort(coordinate, kind="stable")
    total = np.cumsum(weight[order])
    last = len(order) - 1
    low, high = (min(last, int(np.searchsorted(total, part * total[-1]))) for part in BULK)
    return float(coordinate[order[high]]) - float(coordinate[order[low]])


def _cuts(coordinate: Integers, weight: Weights, parts: int) -> tuple[float, ...]:
    """The ``parts`` - 1 half-integers between parts of about equal weight, none of them empty."""
    places, index = np.unique(coordinate, return_inverse=True)
    if len(places) < parts:
        raise UsageError(
            f"--blocks: the anchors lie at {len(places)} places along an axis, too few for "
            f"{parts} blocks; give fewer"
        )
    total = np.cumsum(np.bincount(index, weight))
    ends, last = [], -1
    for part in range(1, parts):
        wanted = int(np.searchsorted(total, total[-1] * part / parts))
        last = min(max(wanted, last + 1), len(places) - 1 - (parts - part))
        ends.append(float(places[last]) + 0.5)
    return tuple(ends)
