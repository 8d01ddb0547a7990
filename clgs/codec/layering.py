"""Which layer of a file each anchor is in: the most useful ones come first."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.codec.contribution import contribution
from clgs.codec.fit_size import anchor_bits
from clgs.errors import UsageError
from clgs.options import MAX_LAYERS
from clgs.scene.scene import QuantizedScene

FIRST = 0.05
"""Share of the anchors' bits in the first layer, if there are several.

With what every layer needs, such as the MLPs, it is about a tenth of a file of 400 kB.
"""

STEPS, LEAST = 1024, 1e-9
"""Ranks are multiples of 1 / STEPS of a factor of two; a share LEAST of the most is as nothing."""

TINY = 1e-300

CHUNK = 1024
"""Anchors per chunk of a layer by default: few enough that a view asks for a part of a layer."""


def choose_layers(
    scene: QuantizedScene,
    count: int,
    importance: npt.NDArray[np.float64] | None = None,
    details: int = 0,
) -> npt.NDArray[np.intp]:
    """The layer (A,), from 0 on, of each anchor, by ``importance`` (A,) per bit of its cost.

    The bits of all layers up to one grow by the same factor from layer to layer, from FIRST on. By
    default it is ``contribution`` as seen from all around. ``details``: layers without anchors that
    follow; the error of too many layers counts them.

    Raises:
        UsageError: there are fewer anchors than layers, or the number is out of range.
    """
    anchors = len(scene.anchors)
    if not 1 <= count <= min(MAX_LAYERS, anchors):
        raise UsageError(
            f"layers: {count + details}; 1 to {MAX_LAYERS} are possible, each of 1 anchor at least"
            f"{' but the last' * details}, and there are {anchors}"
        )
    if importance is None:
        importance = contribution(scene)
    bits = anchor_bits(scene.anchors)
    # Rounded, so that sums whose last bits depend on the machine give the same file on all.
    least = max(LEAST * float(importance.max()), TINY)
    rank = np.rint(STEPS * np.log2(np.maximum(importance, least) / bits))
    order = np.argsort(-rank, kind="stable")
    ends = FIRST ** np.linspace(1, 0, count)[:-1]
    total = np.cumsum(bits[order])
    first = np.searchsorted(total, ends * total[-1])
    # At least one anchor for each layer.
    first = np.clip(first, np.arange(1, count), anchors - np.arange(count - 1, 0, -1))
    first = np.maximum.accumulate(first - np.arange(count - 1)) + np.arange(count - 1)
    layer = np.empty(anchors, np.intp)
    layer[order] = np.searchsorted(first, np.arange(anchors), side="right")
    return layer
