"""Ordinary Gaussians as a camera sees them, in float64, from the definitions.

The harmonics are written as in the source, 3DGS (Kerbl et al. 2023): C[l][m] times polynomials of
the unit direction, given here by their exponents, so that their derivatives follow by rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import LOG_SCALE_LIMIT
from clgs.reference.mlp import CENTRE, view_direction
from clgs.reference.neural import Gaussians
from clgs.reference.project import Array, across

_PI = np.pi
_C1, _C2, _C3 = np.sqrt(3 / (4 * _PI)), np.sqrt(15 / (4 * _PI)), np.sqrt(35 / (32 * _PI))
_C3Z = np.sqrt(21 / (32 * _PI))

Polynomial = dict[tuple[int, int, int], float]

HARMONICS: tuple[Polynomial, ...] = (
    {(0, 0, 0): np.sqrt(1 / (4 * _PI))},
    {(0, 1, 0): -_C1},
    {(0, 0, 1): _C1},
    {(1, 0, 0): -_C1},
    {(1, 1, 0): _C2},
    {(0, 1, 1): -_C2},
    {power: factor * np.sqrt(5 / (16 * _PI))
     for power, factor in {(0, 0, 2): 2.0, (2, 0, 0): -1.0, (0, 2, 0): -1.0}.items()},
    {(1, 0, 1): -_C2},
    {(2, 0, 0): _C2 / 2, (0, 2, 0): -_C2 / 2},
    {(2, 1, 0): -3 * _C3, (0, 3, 0): _C3},
    {(1, 1, 1): np.sqrt(105 / (4 * _PI))},
    {(0, 1, 2): -4 * _C3Z, (2, 1, 0): _C3Z, (0, 3, 0): _C3Z},
    {power: factor * np.sqrt(7 / (16 * _PI))
     for power, factor in {(0, 0, 3): 2.0, (2, 0, 1): -3.0, (0, 2, 1): -3.0}.items()},
    {(1, 0, 2): -4 * _C3Z, (3, 0, 0): _C3Z, (1, 2, 0): _C3Z},
    {(2, 0, 1): np.sqrt(105 / (16 * _PI)), (0, 2, 1): -np.sqrt(105 / (16 * _PI))},
    {(3, 0, 0): -_C3, (1, 2, 0): 3 * _C3},
)  # fmt: skip
"""Coefficient by exponents of x, y and z of the 16 functions up to degree 3."""


@dataclass(frozen=True)
class Stored:
    """The fields of ``clgs.scene.gaussians.OrdinaryGaussians``, float64."""

    mean: Array
    log_scale: Array
    rotation: Array
    opacity: Array
    sh: Array


def basis(direction: Array, count: int) -> Array:
    """(N, count) values of the first functions in unit directions (N, 3)."""
    return polynomials(HARMONICS[:count], direction)


def polynomials(functions: Sequence[Polynomial], direction: Array) -> Array:
    """(N, functions) values in directions (N, 3)."""
    return np.stack([_evaluate(one, direction) for one in functions], axis=1)


def polynomial_slopes(functions: Sequence[Polynomial], direction: Array) -> Array:
    """(N, functions, 3) derivatives by x, y and z."""
    slopes = [
        np.stack([_evaluate(_derivative(one, axis), direction) for axis in range(3)], axis=1)
        for one in functions
    ]
    return np.stack(slopes, axis=1)


def forward(stored: Stored, camera: npt.NDArray[np.floating]) -> Gaussians:
    """N Gaussians with the colors that a camera, ``Camera.pack``, sees."""
    direction, _ = view_direction(stored.mean, np.asarray(camera[CENTRE], np.float64))
    return Gaussians(
        stored.mean,
        np.exp(np.clip(stored.log_scale, -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT)),
        stored.rotation / np.linalg.norm(stored.rotation, axis=1, keepdims=True),
        np.maximum(_colors(stored.sh, direction), 0.0),
        1 / (1 + np.exp(-stored.opacity)),
    )


def backward(stored: Stored, camera: npt.NDArray[np.floating], d_seen: Gaussians) -> Stored:
    """Gradients by the stored arrays from those by what :func:`forward` returned."""
    seen = forward(stored, camera)
    direction, length = view_direction(stored.mean, np.asarray(camera[CENTRE], np.float64))
    count = stored.sh.shape[1]
    d_color = np.where(_colors(stored.sh, direction) > 0, d_seen.color, 0.0)
    weight = np.einsum("nci,ni->nc", stored.sh, d_color)
    d_direction = np.einsum("nc,nck->nk", weight, polynomial_slopes(HARMONICS[:count], direction))
    inside = np.abs(stored.log_scale) <= LOG_SCALE_LIMIT
    return Stored(
        d_seen.mean + across(direction, d_direction) / length,
        np.where(inside, d_seen.scale * seen.scale, 0.0),
        across(seen.rotation, d_seen.rotation)
        / np.linalg.norm(stored.rotation, axis=1, keepdims=True),
        d_seen.opacity * seen.opacity * (1 - seen.opacity),
        basis(direction, count)[:, :, None] * d_color[:, None, :],
    )


def _colors(sh: Array, direction: Array) -> Array:
    """Before they are clamped."""
    return np.asarray(0.5 + np.einsum("nci,nc->ni", sh, basis(direction, sh.shape[1])))


def _evaluate(polynomial: Polynomial, direction: Array) -> Array:
    total = np.zeros(len(direction))
    for powers, factor in polynomial.items():
        total += factor * np.prod(direction ** np.array(powers), axis=1)
    return total


def _derivative(polynomial: Polynomial, axis: int) -> Polynomial:
    found: Polynomial = {}
    for powers, factor in polynomial.items():
        if powers[axis]:
            lower = tuple(p - (i == axis) for i, p in enumerate(powers))
            found[(lower[0], lower[1], lower[2])] = factor * powers[axis]
    return found
