"""Ordinary 3D Gaussians, those of 3DGS files: one record for the host and for device arrays.

Files write their opacities and rotations as numbers of other kinds, which are made here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from clgs.opencl.array import DeviceArray
from clgs.shapes import Shaped, Shapes

Array = TypeVar("Array", bound=Shaped)
Other = TypeVar("Other", bound=Shaped)

MAX_DEGREE = 3
"""The highest degree of the spherical harmonics."""

DEGREES = {(degree + 1) ** 2: degree for degree in range(MAX_DEGREE + 1)}
"""Degree by number of coefficients of a color channel: 1, 4, 9, 16."""


@dataclass(frozen=True)
class OrdinaryGaussians(Generic[Array]):
    """N Gaussians as 3DGS stores and trains them, float32 on the host or on a device.

    mean (N, 3) scene units; log_scale (N, 3) log of scene units; rotation (N, 4) quaternion
    w x y z of any length but 0; opacity (N,) logit; sh (N, C, 3) coefficients of the color, C =
    (degree + 1)^2 in the order of 3DGS. A color is max(0, 1/2 + sum over c of sh[c] * basis[c]).
    antialiased: whether opacities are meant to shrink as the blur of the screen widens a Gaussian
    (Mip-Splatting), so that small ones grow no brighter.

    Raises:
        ValueError: an array has the wrong shape.
    """

    mean: Array
    log_scale: Array
    rotation: Array
    opacity: Array
    sh: Array
    antialiased: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        shapes = Shapes()
        for name, array in self.items():
            shapes.check(name, array, SPECS[name], array.dtype)
        if shapes.axes["C"] not in DEGREES:
            raise ValueError(f"sh: {shapes.axes['C']} coefficients; 1, 4, 9 or 16 are possible")

    def __len__(self) -> int:
        return self.mean.shape[0]

    @property
    def degree(self) -> int:
        """The degree of the spherical harmonics, 0 to 3."""
        return DEGREES[self.sh.shape[1]]

    def items(self) -> Iterator[tuple[str, Array]]:
        """(name, array) in the order of SPECS."""
        return ((name, getattr(self, name)) for name in SPECS)

    def map(self, change: Callable[[Array], Other]) -> OrdinaryGaussians[Other]:
        """The Gaussians whose arrays ``change`` makes, for example ``device.upload``."""
        changed = (change(array) for _, array in self.items())
        return OrdinaryGaussians(*changed, antialiased=self.antialiased)

    def check(self, dtype: npt.DTypeLike) -> None:
        """Raise TypeError if an array has another dtype; shapes are always right."""
        wanted = np.dtype(dtype)
        for name, array in self.items():
            if array.dtype != wanted:
                raise TypeError(f"{name}: dtype is {array.dtype}, expected {wanted}")


SPECS = {"mean": "N 3", "log_scale": "N 3", "rotation": "N 4", "opacity": "N", "sh": "N C 3"}
"""Shape of each array, for ``clgs.shapes``."""

HostGaussians = OrdinaryGaussians[npt.NDArray[np.float32]]
"""Gaussians as files hold them."""

DeviceGaussians = OrdinaryGaussians[DeviceArray]
"""Float32 Gaussians on a device."""


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
