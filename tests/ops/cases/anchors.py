"""Anchors on a device, for the tests of stages that read some of their tensors."""

from __future__ import annotations

from typing import Any

import numpy as np

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.scene.anchors import FIELDS, DeviceAnchors


def on_device(device: Any, values: dict[str, np.ndarray]) -> DeviceAnchors:
    """The tensors in ``values``; zeros for those that are not, and other entries are left out."""
    count = len(next(array for name, array in values.items() if name in FIELDS))
    widths = {
        "position": (3,),
        "offset": (K_OFFSETS, 3),
        "feature": (FEATURE_DIM,),
        "scaling": (6,),
    }
    zeros = {name: np.zeros((count, *width), np.float32) for name, width in widths.items()}
    return DeviceAnchors(*(device.upload(values.get(name, zeros[name])) for name in FIELDS))
