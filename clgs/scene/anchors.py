"""Anchors: the trained parameters of a scene, in float and in integer form."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.shapes import Shapes


@dataclass
class AnchorSet:
    """A anchors in float32.

    position (A, 3) scene units; offset (A, K, 3) in units of exp(scaling[:, :3]);
    feature (A, F); scaling (A, 6) log of scene units: three for offsets, three for shape.
    """

    position: npt.NDArray[np.float32]
    offset: npt.NDArray[np.float32]
    feature: npt.NDArray[np.float32]
    scaling: npt.NDArray[np.float32]

    def __post_init__(self) -> None:
        check_anchor_shapes(self, np.float32)

    def __len__(self) -> int:
        return len(self.position)


@dataclass
class QuantizedAnchors:
    """A anchors as integers (int32), rows in Morton order of ``position``, positions unique.

    Same shapes as :class:`AnchorSet`; dequantised value = integer / Q of ``QuantizationScales``.
    """

    position: npt.NDArray[np.int32]
    offset: npt.NDArray[np.int32]
    feature: npt.NDArray[np.int32]
    scaling: npt.NDArray[np.int32]

    def __post_init__(self) -> None:
        check_anchor_shapes(self, np.int32)

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True)
class QuantizationScales:
    """Q of VOXEL-GS: integers per unit of each attribute (float64, positive, finite)."""

    position: float = 200.0
    offset: float = 1.0
    feature: float = 1.0
    scaling: float = 8.0


def check_anchor_shapes(anchors: AnchorSet | QuantizedAnchors, dtype: npt.DTypeLike) -> None:
    """Raise ValueError or TypeError where an array has the wrong shape or dtype."""
    shapes = Shapes(K=K_OFFSETS, F=FEATURE_DIM)
    specs = {"position": "A 3", "offset": "A K 3", "feature": "A F", "scaling": "A 6"}
    for field in fields(anchors):
        shapes.check(field.name, getattr(anchors, field.name), specs[field.name], dtype)


def dequantize(anchors: QuantizedAnchors, scales: QuantizationScales) -> AnchorSet:
    """The float32 anchors that integers stand for: float32(integer / Q), divided in float64."""
    return AnchorSet(
        *(
            (getattr(anchors, field.name) / np.float64(getattr(scales, field.name))).astype(
                np.float32
            )
            for field in fields(anchors)
        )
    )
