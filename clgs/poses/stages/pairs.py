"""Which photos are compared with which: all with all, or neighbours and look-alikes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from clgs.poses.triangulate import choose_pairs
from clgs.poses.workspace import Workspace

MAX_EXHAUSTIVE = 120
"""Up to this number of photos every pair is matched."""

OVERLAP = 10
"""The photos that follow by name with which a photo of a larger set is matched.

It is also matched with those 16, 32, 64 ... later.
"""

NEAREST = 24
"""The photos, taken nearby in a similar direction, with which one of a given pose is matched."""

LOOK_ALIKES = 20
"""And with this number of photos whose pooled descriptors are the most similar: they close loops.
"""

CENTRES = 64
"""Clusters of descriptors; a photo is pooled by the differences from their centres."""

ROUNDS = 12
SAMPLE = 40_000
"""Descriptors from which the clusters are learned."""

POOLED = 2048
"""Descriptors of a photo that are pooled."""

Floats = npt.NDArray[np.float32]


def pairs_to_match(workspace: Workspace) -> list[tuple[int, int]]:
    """Choose pairs (i, j), i < j, of places in ``workspace.names``.

    Photos with a given pose are compared with those that were taken nearby in a similar direction,
    the others as their number and features suggest.
    """
    names = workspace.names
    known = [place for place, name in enumerate(names) if name in workspace.known]
    pairs = set[tuple[int, int]]()
    if known:
        near = choose_pairs([workspace.known[names[place]] for place in known], NEAREST)
        pairs = {(known[i], known[j]) for i, j in near}
    if len(known) == len(names):
        return sorted(pairs)
    if len(names) <= MAX_EXHAUSTIVE:
        others = list(combinations(range(len(names)), 2))
    else:
        with workspace.open() as database:
            numbers = workspace.ids(database)
            descriptors = [database.read_descriptors(number).data for number in numbers]
        unknown = np.full(3, np.nan)
        positions = np.array([workspace.positions.get(name, unknown) for name in names])
        others = likely_pairs(descriptors, workspace.seed, positions)
    return sorted(pairs.union(pair for pair in others if not set(pair) <= set(known)))


def likely_pairs(
    descriptors: Sequence[npt.NDArray[np.uint8]],
    seed: int,
    positions: npt.NDArray[np.float64] | None = None,
) -> list[tuple[int, int]]:
    """List pairs (i, j), i < j, of photos that follow each other, look alike or are near.

    Args:
        descriptors: (M, 128) per photo, photos in the order of their names.
        seed: of the clusters by which likeness is measured.
        positions: (N, 3) of the N photos, NaN if unknown. Half of the look-alikes of a photo with a
            position give way to those that are the nearest.
    """
    count = len(descriptors)
    steps = [*range(1, OVERLAP + 1), *(2**k for k in range(4, count.bit_length()))]
    pairs = {(i, i + step) for i in range(count) for step in steps if i + step < count}
    # An even choice of each photo's descriptors, as unit vectors.
    chosen = [some[:: max(1, -(-len(some) // POOLED))] for some in descriptors]
    likeness = similarity([_unit(some.astype(np.float32)) for some in chosen], seed)
    np.fill_diagonal(likeness, -np.inf)
    for i, row in enumerate(np.argsort(-likeness, axis=1, kind="stable")[:, :LOOK_ALIKES]):
        chosen_for = row.tolist()
        if positions is not None and np.isfinite(positions[i, 0]):
            away = np.linalg.norm(positions - positions[i], axis=1)  # NaN comes last
            away[i] = np.nan
            nearest = np.argsort(away, kind="stable")[: LOOK_ALIKES // 2].tolist()
            chosen_for = [*chosen_for[: LOOK_ALIKES // 2], *nearest]
        pairs |= {(min(i, j), max(i, j)) for j in chosen_for if j != i}
    return sorted(pairs)


def similarity(descriptors: Sequence[Floats], seed: int) -> Floats:
    """Compute cosines (N, N) between photos whose descriptors (M, 128) are pooled as in VLAD.

    Jégou et al., Aggregating local descriptors into a compact image representation, CVPR 2010, with
    the normalisation of each cluster by Arandjelović and Zisserman, All about VLAD, CVPR 2013.
    """
    centres = _cluster(descriptors, seed)
    pooled = np.empty((len(descriptors), centres.size), np.float32)
    for row, some in zip(pooled, descriptors, strict=True):
        nearest = _nearest(some, centres)
        sums = _sums(some - centres[nearest], nearest, len(centres))
        row[:] = _unit(_unit(sums).ravel())
    return np.asarray(pooled @ pooled.T)


def _unit(rows: Floats) -> Floats:
    length = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.asarray(rows / np.maximum(length, 1e-12))


def _cluster(descriptors: Sequence[Floats], seed: int) -> Floats:
    """Find centres (CENTRES, 128) by k-means on a sample of all descriptors."""
    rng = np.random.default_rng(seed)
    every = np.concatenate(descriptors)
    sample = every[rng.permutation(len(every))[:SAMPLE]]
    centres = sample[:CENTRES]
    for _ in range(ROUNDS):
        nearest = _nearest(sample, centres)
        sums = _sums(sample, nearest, len(centres))
        size = np.bincount(nearest, minlength=len(centres))[:, None]
        centres = np.where(size > 0, sums / np.maximum(size, 1), centres).astype(np.float32)
    return centres


def _sums(rows: Floats, group: npt.NDArray[np.int64], count: int) -> Floats:
    """Sum the rows (M, 128) of each of ``count`` groups; a product is faster than np.add.at."""
    return np.asarray((np.arange(count)[:, None] == group).astype(rows.dtype) @ rows)


def _nearest(descriptor: Floats, centres: Floats) -> npt.NDArray[np.int64]:
    """Find the number (M,) of the centre nearest to each descriptor."""
    half_square = 0.5 * (centres**2).sum(1)
    return np.asarray((descriptor @ centres.T - half_square).argmax(1))
