"""Tables of 256 numbers and palettes of sets of coefficients, for SOG files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]

TABLE_SIZE = 256
TABLE_ROUNDS = 20
PALETTE_PARTS = 128
"""The sets are parted into so many first, and each part by itself then."""
MAX_PALETTE = 65536
MEMBERS = 2
"""Gaussians for each entry of a palette, on average."""
PALETTE_ROUNDS = 8
SEED = 0


@dataclass(frozen=True)
class Palette:
    """Sets of coefficients: entries (P, C - 1, 3) uint8 point into the table (256,) float32.

    label (N,) int64: the entry of each Gaussian.
    """

    entries: npt.NDArray[np.uint8]
    table: Floats
    label: npt.NDArray[np.int64]

    def values(self) -> Floats:
        """The coefficients (N, C - 1, 3) of the Gaussians."""
        return np.asarray(self.table[self.entries[self.label]])


def make_table(values: Floats) -> Floats:
    """256 ascending numbers near which all ``values`` lie: means of nearest ones, repeated."""
    ordered = np.sort(values, axis=None).astype(np.float64)
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    share = (np.arange(TABLE_SIZE) + 0.5) / TABLE_SIZE
    # half by rank, half by size: many values, and those far out, get their entries
    by_rank = ordered[(share * len(ordered)).astype(int)]
    by_size = ordered[0] + share * (ordered[-1] - ordered[0])
    table = np.sort(0.5 * (by_rank + by_size))
    for _ in range(TABLE_ROUNDS):
        bounds = np.searchsorted(ordered, 0.5 * (table[1:] + table[:-1]))
        first, end = np.r_[0, bounds], np.r_[bounds, len(ordered)]
        count = end - first
        table = np.where(count > 0, (sums[end] - sums[first]) / np.maximum(count, 1), table)
    return np.sort(table).astype(np.float32)


def nearest(table: Floats, values: Floats) -> npt.NDArray[np.uint8]:
    """Which entry of an ascending table is nearest to each value."""
    bounds = 0.5 * (table[1:].astype(np.float64) + table[:-1])
    return np.searchsorted(bounds, values).astype(np.uint8)


def make_palette(coefficients: Floats) -> Palette:
    """A palette for N sets of coefficients (N, C - 1, 3): half as many, at most MAX_PALETTE."""
    count, size, _ = coefficients.shape
    rows = coefficients.reshape(count, -1)
    wanted = min(MAX_PALETTE - PALETTE_PARTS, max(1, count // MEMBERS))
    centres, label = _cluster_in_two(rows, wanted)
    table = make_table(centres)
    return Palette(nearest(table, centres).reshape(-1, size, 3), table, label)


def _cluster_in_two(rows: Floats, wanted: int) -> tuple[Floats, npt.NDArray[np.int64]]:
    """About ``wanted`` centres, and the one of each row; parts first, then each part.

    Every part has one at least: there may be PALETTE_PARTS more than wanted.
    """
    rng = np.random.default_rng(SEED)
    _, part = _cluster(rows, min(PALETTE_PARTS, wanted), rng)
    label = np.empty(len(rows), np.int64)
    centres, used = [], 0
    for number in np.unique(part):
        members = np.flatnonzero(part == number)
        share = wanted * len(members) // len(rows)
        found, own = _cluster(rows[members], max(1, share), rng)
        label[members] = used + own
        centres.append(found)
        used += len(found)
    return np.concatenate(centres), label


def _cluster(
    rows: Floats, wanted: int, rng: np.random.Generator
) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Lloyd's rounds from rows drawn at random; centres without rows stay where they are."""
    centres = rows[np.sort(rng.permutation(len(rows))[:wanted])]
    for _ in range(PALETTE_ROUNDS):
        label = _closest(rows, centres)
        count = np.bincount(label, minlength=len(centres))
        order = np.argsort(label, kind="stable")
        used = np.flatnonzero(count)
        first = np.concatenate([[0], np.cumsum(count)[:-1]])[used]
        sums = np.add.reduceat(rows[order], first, axis=0)
        centres = centres.copy()
        centres[used] = sums / count[used, None]
    return centres, _closest(rows, centres)


def _closest(rows: Floats, centres: Floats) -> npt.NDArray[np.int64]:
    square = 0.5 * np.square(centres).sum(axis=1)
    return np.concatenate(
        [
            np.argmin(square - rows[start : start + 8192] @ centres.T, axis=1)
            for start in range(0, len(rows), 8192)
        ]
    )
