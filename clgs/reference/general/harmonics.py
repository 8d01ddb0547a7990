"""Colors from spherical harmonics of degree 0 to 4 in float64, as polynomials of the direction.

Degree 4 as in Sloan, Efficient Spherical Harmonic Evaluation (2013), with the signs of 3DGS.
"""

from __future__ import annotations

import numpy as np

from clgs.reference.general.splats import (
    HARMONICS,
    Polynomial,
    polynomial_slopes,
    polynomials,
)
from clgs.reference.mlp import view_direction
from clgs.reference.project import Array, across

_F, _E = np.sqrt(35 / np.pi), np.sqrt(35 / (2 * np.pi))
_D, _C, _A = np.sqrt(5 / np.pi), np.sqrt(5 / (2 * np.pi)), np.sqrt(1 / np.pi)

DEGREE_4: tuple[Polynomial, ...] = (
    {(3, 1, 0): 0.75 * _F, (1, 3, 0): -0.75 * _F},
    {(2, 1, 1): -2.25 * _E, (0, 3, 1): 0.75 * _E},
    {(1, 1, 2): 5.25 * _D, (1, 1, 0): -0.75 * _D},
    {(0, 1, 3): -5.25 * _C, (0, 1, 1): 2.25 * _C},
    {(0, 0, 4): 105 / 16 * _A, (0, 0, 2): -90 / 16 * _A, (0, 0, 0): 9 / 16 * _A},
    {(1, 0, 3): -5.25 * _C, (1, 0, 1): 2.25 * _C},
    {(2, 0, 2): 2.625 * _D, (0, 2, 2): -2.625 * _D, (2, 0, 0): -0.375 * _D, (0, 2, 0): 0.375 * _D},
    {(3, 0, 1): -0.75 * _E, (1, 2, 1): 2.25 * _E},
    {(4, 0, 0): 3 / 16 * _F, (2, 2, 0): -18 / 16 * _F, (0, 4, 0): 3 / 16 * _F},
)
"""Coefficient by exponents of x, y and z on the unit sphere."""

ALL = (*HARMONICS, *DEGREE_4)


def forward(mean: Array, sh: Array, centre: Array, degree: int, bare: bool = False) -> Array:
    """Colors (N, 3); arguments as in ``clgs.ops.general.harmonics``, ``centre`` (3,)."""
    direction, _ = view_direction(mean, centre)
    used = (degree + 1) ** 2
    sums = np.einsum("nci,nc->ni", sh[:, :used], polynomials(ALL[:used], direction))
    return np.asarray(sums if bare else np.maximum(0.5 + sums, 0.0))


def backward(
    mean: Array, sh: Array, centre: Array, degree: int, d_color: Array, bare: bool = False
) -> tuple[Array, Array]:
    """Gradients by the harmonics and by the means."""
    direction, length = view_direction(mean, centre)
    used = (degree + 1) ** 2
    if not bare:
        d_color = np.where(forward(mean, sh, centre, degree) > 0, d_color, 0.0)
    d_sh = np.zeros_like(sh)
    d_sh[:, :used] = polynomials(ALL[:used], direction)[:, :, None] * d_color[:, None, :]
    weight = np.einsum("nci,ni->nc", sh[:, :used], d_color)
    slope = np.einsum("nc,nck->nk", weight, polynomial_slopes(ALL[:used], direction))
    return d_sh, across(direction, slope) / length
