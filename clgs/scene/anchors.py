"""Anchors: the trained tensors of a scene, one record for floats, integers and device arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.opencl.array import DeviceArray
from clgs.shapes import Shaped, Shapes

Array = TypeVar("Array", bound=Shaped)
Other = TypeVar("Other", bound=Shaped)
Number = TypeVar("Number", np.float32, np.int32)

SPECS = {"position": "A 3", "offset": "A K 3", "feature": "A F", "scaling": "A 6"}
"""Shape of each tensor, for ``clgs.shapes``."""


@dataclass(frozen=True)
class Anchors(Generic[Array]):
    """The four tensors of A anchors: float32 on the host or on a device, or int32 integers.

    position (A, 3) scene units; offset (A, K, 3) in units of exp(scaling[:, :3]);
    feature (A, F); scaling (A, 6) log of scene units: three for offsets, three for shape.

    Raises:
        ValueError: a tensor has the wrong shape.
    """

    position: Array
    offset: Array
    feature: Array
    scaling: Array

    def __post_init__(self) -> None:
        shapes = Shapes(K=K_OFFSETS, F=FEATURE_DIM)
        for name, array in self.items():
            shapes.check(name, array, SPECS[name], array.dtype)

    def __len__(self) -> int:
        return self.position.shape[0]

    def items(self) -> Iterator[tuple[str, Array]]:
        """(name, tensor) in the order of FIELDS."""
        return ((name, getattr(self, name)) for name in FIELDS)

    def map(self, change: Callable[[Array], Other]) -> Anchors[Other]:
        """The anchors whose tensors ``change`` makes, for example ``device.upload``."""
        return Anchors(*(change(array) for _, array in self.items()))

    def check(self, dtype: npt.DTypeLike) -> None:
        """Raise TypeError if a tensor has another dtype; shapes are always right."""
        wanted = np.dtype(dtype)
        for name, array in self.items():
            if array.dtype != wanted:
                raise TypeError(f"{name}: dtype is {array.dtype}, expected {wanted}")


FIELDS = tuple(field.name for field in fields(Anchors))
"""Names of the tensors, in the order of files and hashes."""

AnchorSet = Anchors[npt.NDArray[np.float32]]
"""Anchors as they are trained and rendered."""

QuantizedAnchors = Anchors[npt.NDArray[np.int32]]
"""Anchors as a file holds them, dequantised value = integer / Q of ``QuantizationScales``.

In a file, rows are in Morton order of ``position``, and positions are unique.
"""

DeviceAnchors = Anchors[DeviceArray]
"""Float32 anchors on a device."""


def take(
    anchors: Anchors[npt.NDArray[Number]], rows: npt.NDArray[np.generic] | slice
) -> Anchors[npt.NDArray[Number]]:
    """The anchors of some rows: indices, a mask (A,) or a slice."""
    return anchors.map(lambda array: array[rows])


def concatenate(
    parts: Sequence[Anchors[npt.NDArray[Number]]],
) -> Anchors[npt.NDArray[Number]]:
    """The rows of all parts, one part after the other."""
    return Anchors(*(np.concatenate([getattr(part, name) for part in parts]) for name in FIELDS))


@dataclass(frozen=True)
class QuantizationScales:
    """Q of VOXEL-GS: integers per unit of each attribute (float64, positive, finite)."""

    position: float = 200.0
    offset: float = 1.0
    feature: float = 1.0
    scaling: float = 8.0


def rounded(values: npt.NDArray[np.float32], q: float) -> npt.NDArray[np.int32]:
    """The integers of values at ``q`` integers per unit, rounded in float32 as the kernel does."""
    scaled = values * np.float32(q)
    np.rint(scaled, out=scaled)
    return np.asarray(scaled, np.int32)


def quantize(anchors: AnchorSet, scales: QuantizationScales) -> QuantizedAnchors:
    """The integers of trained anchors, rounded in float32 as the kernel does; same row order."""
    return Anchors(*(rounded(array, getattr(scales, name)) for name, array in anchors.items()))


def dequantize(anchors: QuantizedAnchors, scales: QuantizationScales) -> AnchorSet:
    """The float32 anchors that integers stand for: float32(integer / Q), divided in float64."""
    return Anchors(
        *(
            (array / np.float64(getattr(scales, name))).astype(np.float32)
            for name, array in anchors.items()
        )
    )
