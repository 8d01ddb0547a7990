"""The blocks of a scene to one scene: each gives the anchors that it owns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from clgs.cluster.blocks.cuts import Cuts
from clgs.codec.scene_encoder import sort_anchors
from clgs.errors import DataError
from clgs.scene.anchors import concatenate, take
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import load_scene


def merged_scene(folder: Path, cuts: Cuts, coarse: QuantizedScene) -> QuantizedScene:
    """The scene of the blocks in ``folder``, in Morton order, with the MLPs of the coarse one.

    Raises:
        DataError: the scene of a block is missing or damaged, or not of these units.
    """
    parts, scales = [], coarse.scales
    for number, name in enumerate(cuts.names):
        path = folder / name / "scene.npz"
        block = load_scene(path)
        if (block.scales, block.transform) != (scales, coarse.transform):
            raise DataError(f"{path}: has other units than the coarse scene; remove its folder")
        owned = cuts.owner(block.anchors.position) == number
        parts.append(take(block.anchors, np.flatnonzero(owned)))
    return replace(coarse, anchors=sort_anchors(concatenate(parts)))
