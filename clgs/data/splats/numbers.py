"""How files of splats write opacities and rotations."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

MAX_OPACITY = 1.0 - 1e-6
"""Opacities of 0 and 1 have no logit; readers come this close to them."""

SH_0 = 0.28209479177387814
"""The first of the spherical harmonics: a color is 1/2 + SH_0 * f_dc + ..."""


def sigmoid(logit: npt.NDArray[np.float32]) -> Floats:
    """Opacities in (0, 1) of logits."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(logit.astype(np.float64), -80.0, 80.0))))


def logit(opacity: Floats) -> npt.NDArray[np.float32]:
    """The inverse of :func:`sigmoid`."""
    inside = np.clip(opacity, 1.0 - MAX_OPACITY, MAX_OPACITY)
    return np.log(inside / (1.0 - inside)).astype(np.float32)


def smallest_three(unit: Floats) -> tuple[npt.NDArray[np.int64], Floats]:
    """Index (N,) of the largest component of unit quaternions (N, 4), and the others (N, 3).

    Their signs are those that make the largest positive.
    """
    largest = np.argmax(np.abs(unit), axis=1)
    signed = unit * np.where(unit[np.arange(len(unit)), largest] < 0, -1.0, 1.0)[:, None]
    return largest, signed[np.arange(4) != largest[:, None]].reshape(-1, 3)


def from_smallest_three(largest: npt.NDArray[np.int64], small: Floats) -> Floats:
    """The quaternions (N, 4) of which :func:`smallest_three` gives these, as readers make them."""
    whole = np.zeros((len(largest), 4))
    whole[np.arange(4) != largest[:, None]] = small.ravel()
    rest = np.sqrt(np.maximum(0.0, 1.0 - np.square(whole).sum(axis=1)))
    whole[np.arange(len(whole)), largest] = rest
    return whole


def unit_rotation(rotation: npt.NDArray[np.float32]) -> Floats:
    """Quaternions (N, 4) of length 1; one without direction becomes that of no rotation."""
    wide = rotation.astype(np.float64)
    length = np.linalg.norm(wide, axis=1, keepdims=True)
    wide = np.where(length > 0, wide, [1.0, 0.0, 0.0, 0.0])
    return np.asarray(wide / np.where(length > 0, length, 1.0))
