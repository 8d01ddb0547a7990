"""Which photos are compared with which: all with all, or neighbours and look-alikes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

MAX_EXHAUSTIVE = 120
"""Up to so many photos every pair is matched."""

OVERLAP = 10
"""Beyond, each photo with so many that follow it by name, and with those 16, 32, 64 ... later."""

LOOK_ALIKES = 20
"""And with so many photos whose pooled descriptors are the most similar: these close loops."""

CENTRES = 64
"""Clusters of descriptors; each photo is the sum of its descriptors' distances from theirs."""

ROUNDS = 12
SAMPLE = 40_000
"""Descriptors that the clusters are learned from."""

POOLED = 2048
"""Descriptors of a photo that are pooled."""

Floats = npt.NDArray[np.float32]


def all_pairs(count: int) -> list[tuple[int, int]]:
    """Every pair (i, j), i < j, of ``count`` photos."""
    return [(i, j) for i in range(count) for j in range(i + 1, count)]


def likely_pairs(descriptors: Sequence[npt.NDArray[np.uint8]], seed: int) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of photos that follow each other or look alike.

    Args:
        descriptors: (M, 128) of every photo, photos in the order of their names.
        seed: of the clusters' start.
    """
    count = len(descriptors)
    steps = [*range(1, OVERLAP + 1), *(2**k for k in range(4, count.bit_length()))]
    pairs = {(i, i + step) for i in range(count) for step in steps if i + step < count}
    likeness = similarity([_rooted(some) for some in descriptors], seed)
    np.fill_diagonal(likeness, -np.inf)
    for i, row in enumerate(np.argsort(-likeness, axis=1, kind="stable")[:, :LOOK_ALIKES]):
        pairs |= {(min(i, j), max(i, j)) for j in row.tolist() if j != i}
    return sorted(pairs)


def similarity(descriptors: Sequence[Floats], seed: int) -> Floats:
    """Cosines (N, N) between photos, whose descriptors (M, 128) are pooled as VLAD does.

    Jégou et al., Aggregating local descriptors into a compact image representation, CVPR 2010, with
    the normalisation of each cluster by Arandjelović and Zisserman, All about VLAD, CVPR 2013.
    """
    centres = _cluster(descriptors, seed)
    pooled = np.stack([_pool(some, centres) for some in descriptors])
    return np.asarray(pooled @ pooled.T)


def _rooted(descriptor: npt.NDArray[np.uint8]) -> Floats:
    """An even choice of at most POOLED descriptors, as unit vectors."""
    step = max(1, -(-len(descriptor) // POOLED))
    some = descriptor[::step].astype(np.float32)
    return _unit(some)


def _unit(rows: Floats) -> Floats:
    length = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.asarray(rows / np.maximum(length, 1e-12))


def _cluster(descriptors: Sequence[Floats], seed: int) -> Floats:
    """Centres (CENTRES, 128) of k-means on a sample of all descriptors."""
    rng = np.random.default_rng(seed)
    every = np.concatenate(descriptors)
    sample = every[rng.permutation(len(every))[:SAMPLE]]
    centres = sample[:CENTRES]
    for _ in range(ROUNDS):
        nearest = _nearest(sample, centres)
        sums = np.zeros_like(centres)
        np.add.at(sums, nearest, sample)
        size = np.bincount(nearest, minlength=len(centres))[:, None]
        centres = np.where(size > 0, sums / np.maximum(size, 1), centres).astype(np.float32)
    return centres


def _nearest(descriptor: Floats, centres: Floats) -> npt.NDArray[np.int64]:
    """Number (M,) of the centre next to each descriptor."""
    half_square = 0.5 * (centres**2).sum(1)
    return np.asarray((descriptor @ centres.T - half_square).argmax(1))


def _pool(descriptor: Floats, centres: Floats) -> Floats:
    """Unit vector (CENTRES * 128,) of the sums of distances from the nearest centres."""
    sums = np.zeros_like(centres)
    if len(descriptor):
        nearest = _nearest(descriptor, centres)
        np.add.at(sums, nearest, descriptor - centres[nearest])
    return _unit(_unit(sums).ravel())
