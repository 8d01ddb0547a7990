"""Ordinary 3D Gaussians, those of 3DGS files: one record for the host and for device arrays."""

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
