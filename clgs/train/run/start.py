"""What training starts from: the data set's points and some MLPs, a trained scene, or a run.

The MLPs are those trained on other scenes, random ones, or those of a scene. What the networks make
of features hardly differs between scenes, so that a run that starts from trained ones has only the
features to find; a feature of zeros stands for a mean anchor. ``scripts/train_start_mlps.py`` made
the ones that ship. Those for objects read 40 of the features; the others stay zero, and take hardly
a byte.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np

from clgs.codec.scene_decoder import decode
from clgs.data.dataset import Dataset
from clgs.errors import CodecError, DataError, UsageError
from clgs.opencl.device import Device
from clgs.scene.mlps import MLP_SIZE, Mlps, init_mlps
from clgs.scene.scene import Scene
from clgs.scene.storage import load_scene
from clgs.train.config import TrainConfig
from clgs.train.config.run_settings import LEAST_ANCHORS, OBJECTS, RANDOM, TRAINED
from clgs.train.config.settings import BLENDER
from clgs.train.density.voxel_grid import initial_anchors
from clgs.train.run.run_folder import finished_settings, settings_for
from clgs.train.state.checkpoint import checkpoints
from clgs.train.state.hashes import run_digest
from clgs.train.state.resume import load_state
from clgs.train.state.run_state import RunState, new_exposures, new_state

SHIPPED = {TRAINED: "trained_mlps.npy", OBJECTS: "object_mlps.npy"}


def first_state(device: Device, dataset: Dataset, config: TrainConfig) -> RunState:
    """The state of a run before its first step; ``config`` is resolved for ``dataset``.

    Raises:
        DataError: the points, or the file of ``config.start_mlps``, cannot be used.
    """
    rng = np.random.default_rng(config.seed)
    limits = [config.most_anchors] if config.most_anchors else []
    if config.start_pixels and dataset.kind != BLENDER:
        pixels = max(view.camera.width * view.camera.height for view in dataset.train)
        limits.append(max(LEAST_ANCHORS, int(pixels / config.start_pixels)))
    most = min(limits, default=0)  # 0: one per voxel that holds points
    anchors = initial_anchors(dataset.points, config.voxel, most, config.seed)
    mlps = start_mlps(config.start_mlps, rng)
    return new_state(device, config, len(dataset.train), anchors, mlps, rng)


def state_of_scene(
    device: Device, dataset: Dataset, config: TrainConfig, scene: Scene, step: int
) -> RunState:
    """The state of a run that goes on with a trained scene after step number ``step``.

    The moments and statistics are zero, and bits have no price. ``dataset``: views in the scene's
    units; ``config`` is resolved for it.
    """
    rng = np.random.default_rng(config.seed)
    state = new_state(device, config, len(dataset.train), scene.anchors, scene.mlps, rng)
    state.step = step
    return state


def state_of_run(device: Device, dataset: Dataset, config: TrainConfig, folder: Path) -> RunState:
    """The state of a run that goes on from the finished run in ``folder``.

    That is the last checkpoint if it is of the last step and of the same data set at the same
    size; else the scene, so that moments and statistics begin at zero. The next round sets the
    price of a bit if lambda or the size differ.

    Args:
        device: where to train.
        dataset: in the units of the run's scene; it need not be the one of ``folder``.
        config: resolved for the dataset.
        folder: of a finished run.

    Raises:
        DataError: ``folder`` holds no finished run, or a damaged one.
        UsageError: the run has done ``config.steps`` already, or has positions on another grid.
    """
    found, old = finished_settings(folder)
    steps, scales = int(found.summary["steps"]), found.scene.scales
    if config.steps <= steps:
        raise UsageError(
            f"steps: {folder} has done {steps}, which count; give more than that, or leave it out"
        )
    if steps > config.switch_step and config.position_q != scales.position:
        raise UsageError(
            f"position_q: positions of {folder} are multiples of 1 / {scales.position:g} already; "
            "leave it and voxel out, or give a later switch_step"
        )
    saved = checkpoints(folder / "checkpoint")[-1:]
    same = found.summary["digest"] == run_digest(dataset, settings_for(dataset, old))
    if same and saved and int(saved[0].stem.removeprefix("step_")) == steps:
        state = load_state(folder / "checkpoint", device, found.summary["digest"])
    else:
        state = state_of_scene(device, dataset, config, found.scene.dequantize(), steps)
        state.rate.scales = scales
    if (state.exposures is None) == config.exposure:
        state.exposures = new_exposures(device, config, len(dataset.train))
    if (config.size_lambda, config.target_size) != (old.size_lambda, old.target_size):
        state.rate.price = 0.0
    return state


def start_mlps(name: str, rng: np.random.Generator) -> Mlps:
    """The MLPs called ``name``: TRAINED, OBJECTS, RANDOM, or those of a run or a scene's file.

    Raises:
        DataError: the file cannot be read, or is no scene.
    """
    if file_name := SHIPPED.get(name):
        with resources.files(__package__).joinpath(file_name).open("rb") as file:
            flat = np.load(file, allow_pickle=False)
        if flat.shape != (MLP_SIZE,) or flat.dtype != np.float32:
            raise DataError(f"{file_name}: not {MLP_SIZE} float32 weights; install clgs again")
        return Mlps(flat)
    if name == RANDOM:
        return init_mlps(rng)
    path = Path(name)
    path = path / "scene.clgs" if path.is_dir() else path
    if path.suffix.lower() == ".npz":
        return load_scene(path).mlps
    if path.suffix.lower() != ".clgs":
        raise DataError(
            f"start_mlps: {name} is no scene; give {', '.join(SHIPPED)}, {RANDOM}, or a .clgs or "
            ".npz file"
        )
    try:
        return decode(path.read_bytes()).mlps
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}; start_mlps names a scene's file") from error
    except CodecError as error:
        raise CodecError(f"{path}: {error}") from error
