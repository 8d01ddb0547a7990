"""The blocks of a scene to one scene: each gives the anchors that it owns, and the best stay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from clgs.cluster.blocks.cuts import Cuts
from clgs.cluster.blocks.task import block_state
from clgs.codec.scene_encoder import sort_anchors
from clgs.data.dataset import Dataset
from clgs.errors import DataError
from clgs.opencl.device import Device
from clgs.scene.anchors import concatenate, take
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import load_scene
from clgs.train.config import TrainConfig
from clgs.train.rate.economy import Economy
from clgs.train.state.rounding import Rounding
from clgs.train.state.run_state import RunState


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


def merged_state(
    device: Device, dataset: Dataset, merged: QuantizedScene, begun: int, config: TrainConfig
) -> RunState:
    """The state in which all of ``merged`` learns after step ``begun``, without the least anchors.

    An ordinary run leaves them out in rounds before its switch to integers, and grows others
    after the first of these; here the rounds after the first one, up to ``begun``, follow each
    other. Without a price all anchors stay.
    """
    state = block_state(device, dataset, merged, begun, config)
    economy = Economy(device, dataset, config, Rounding(device, config))
    for step in economy.steps[1:]:
        if step <= begun:
            economy.round(state, step)
    return state
