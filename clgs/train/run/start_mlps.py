"""The MLPs that training starts from: those trained on other scenes, random ones, or a scene's.

What the networks make of features hardly differs between scenes, so that a run that starts from
trained ones has only the features to find; a feature of zeros stands for a mean anchor.
``scripts/train_start_mlps.py`` made the ones that ship.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np

from clgs.codec.scene_decoder import decode
from clgs.errors import DataError
from clgs.scene.mlps import MLP_SIZE, Mlps, init_mlps
from clgs.scene.storage import load_scene

TRAINED = "trained"

RANDOM = "random"

SHIPPED = "trained_mlps.npy"


def start_mlps(name: str, rng: np.random.Generator) -> Mlps:
    """The MLPs called ``name``: TRAINED, RANDOM, or a scene's .clgs or .npz file.

    Raises:
        DataError: the file cannot be read, or is no scene.
    """
    if name == TRAINED:
        return trained_mlps()
    if name == RANDOM:
        return init_mlps(rng)
    path = Path(name)
    if path.suffix.lower() == ".npz":
        return load_scene(path).mlps
    if path.suffix.lower() != ".clgs":
        raise DataError(
            f"start_mlps: {name} is no scene; give {TRAINED}, {RANDOM}, or a .clgs or .npz file"
        )
    try:
        return decode(path.read_bytes()).mlps
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}; start_mlps names a scene's file") from error


def trained_mlps() -> Mlps:
    """The MLPs that ship with clgs."""
    with resources.files(__package__).joinpath(SHIPPED).open("rb") as file:
        flat = np.load(file, allow_pickle=False)
    if flat.shape != (MLP_SIZE,) or flat.dtype != np.float32:
        raise DataError(f"{SHIPPED}: not {MLP_SIZE} float32 weights; install clgs anew")
    return Mlps(flat)
