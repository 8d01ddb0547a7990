"""What training starts from: the data set, its points and some MLPs, a trained scene, or a run.

The MLPs are those trained on other scenes, random ones, or those of a scene. What the networks make
of features hardly differs between scenes, so that a run that starts from trained ones has only the
features to find; a feature of zeros stands for a mean anchor. ``scripts/train_start_mlps.py`` made
the ones that ship. Those for objects read 40 of the features; the others stay zero, and take hardly
a byte.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.codec.scene_decoder import decode
from clgs.data.dataset import LEAST_POINTS, Dataset, load_dataset, to_scene_points
from clgs.data.points import filled, grown_mask, hull_points, random_points
from clgs.errors import CodecError, DataError, UsageError
from clgs.opencl.device import Device
from clgs.poses.triangulate import triangulate
from clgs.scene.mlps import MLP_SIZE, Mlps, init_mlps
from clgs.scene.scene import Scene
from clgs.scene.storage import load_scene
from clgs.train.config import TrainConfig
from clgs.train.config.run_settings import LEAST_ANCHORS, OBJECTS, RANDOM, TRAINED
from clgs.train.config.settings import BLENDER
from clgs.train.run.run_folder import RunResult, finished_settings, settings_for
from clgs.train.state.checkpoint import checkpoints, load_state
from clgs.train.state.hashes import run_digest
from clgs.train.state.run_state import Means, RunState, new_exposures, new_state
from clgs.train.state.voxel_grid import initial_anchors

MIN_TRIANGULATED = 100
"""Fewer triangulated points count as a failure."""

_log = logging.getLogger(__name__)


def load_for(
    config: TrainConfig,
    data: str | Path,
    cache: Path,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Dataset:
    """The data set in the folder ``data`` for a run with these settings, with points.

    ``config`` need not be resolved for the data set; ``cache`` and ``on_stage`` as for
    :func:`with_points`.

    Raises:
        DataError: as of :func:`clgs.load_dataset` and :func:`with_points`.
    """
    dataset = load_dataset(
        data,
        downscale=config.downscale,
        max_size=config.max_size,
        preset_units=not config.normalize,
        photo_memory=config.photo_memory * 2**20,
        points_file=Path(config.points) if config.points else None,
        point_samples=config.point_samples,
        seed=config.seed,
        masks=config.masks,
        test_every=config.test_every,
        fisheye_view=config.fisheye_view,
    )
    return with_points(dataset, config, cache, on_stage)


def with_points(
    dataset: Dataset,
    config: TrainConfig | None = None,
    cache: Path | None = None,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Dataset:
    """The data set with points to start training from, which it may have already.

    Points for photos that come with poses alone are triangulated, which takes minutes. If too few
    are found, and for Blender scenes, random points are drawn in the volume that cameras share.

    Args:
        dataset: its folder still holds the photos.
        config: of the run, for the seed and the random points; default: ``TrainConfig()``.
        cache: folder that keeps triangulated points, as the user's cache folder does; never the
            data folder.
        on_stage: called with a line before work that takes minutes.

    Raises:
        DataError: no two photos look at the same place.
    """
    config = config or TrainConfig()
    if len(dataset.points) >= LEAST_POINTS or not dataset.train:
        return dataset
    if dataset.kind == "colmap":
        _log.warning(_TOO_FEW, dataset.folder, len(dataset.points))
    elif must_triangulate(dataset):
        dataset = _triangulated(dataset, cache, config.seed, on_stage)
        if len(dataset.points) >= LEAST_POINTS:
            return dataset
    viewpoints = [(view.camera, grown_mask(view.photo.pixels().alpha)) for view in dataset.train]
    start = config.seed, config.start_points, config.start_volume == "hull"
    points = random_points(viewpoints, dataset.radius, dataset.kind == "blender", *start)
    if len(points) < LEAST_POINTS:
        raise DataError(
            f"{dataset.folder}: no two photos look at the same place; check the poses and their "
            "axes"
        )
    return replace(dataset, points=points, point_colors=None, drawn=True)


def must_triangulate(dataset: Dataset) -> bool:
    """Whether :func:`with_points` triangulates points, which takes minutes."""
    return len(dataset.points) < LEAST_POINTS and dataset.kind not in ("colmap", "blender")


_TOO_FEW = "%s: only %d usable points, starting from random ones"


def _triangulated(
    dataset: Dataset, cache: Path | None, seed: int, on_stage: Callable[[str], None]
) -> Dataset:
    """The data set with points triangulated from its training photos, or without any."""
    names = {view.name for view in dataset.train}
    photos = [photo for photo in dataset.photos if photo.name in names]
    try:
        found = triangulate(photos, cache, seed, on_stage)
    except DataError as error:
        _log.warning("no triangulated points, starting from random ones: %s", error)
        return dataset
    if len(found.position) < MIN_TRIANGULATED:
        count = len(found.position)
        _log.warning("only %d points triangulated, starting from random ones", count)
        return dataset
    points, colors = to_scene_points(dataset, found.position, found.color)
    if len(points) < LEAST_POINTS:
        _log.warning(_TOO_FEW, dataset.folder, len(points))
    return replace(dataset, points=points, point_colors=colors)


SHIPPED = {TRAINED: "trained_mlps.npy", OBJECTS: "object_mlps.npy"}


FILL_PIXELS = 6.0
"""More start points than one for this many pixels of a photo need none between them: these gain
little, and cost time."""


def first_state(device: Device, dataset: Dataset, config: TrainConfig) -> RunState:
    """The state of a run before its first step; ``config`` is resolved for ``dataset``.

    Raises:
        DataError: the points, or the file of ``config.start_mlps``, cannot be used.
        UsageError: only the anchors of a box learn, and it holds none.
    """
    rng = np.random.default_rng(config.seed)
    limits, points = [config.most_anchors] if config.most_anchors else [], dataset.points
    if dataset.kind == BLENDER:
        if dataset.drawn and not config.start_points:
            points = points[: hull_points(config.steps * config.batch)]
    else:
        pixels = max(view.camera.width * view.camera.height for view in dataset.train)
        wanted = min(config.start_fill * len(points), pixels / FILL_PIXELS)
        points = filled(points, int(wanted), config.seed)
        if config.start_pixels:
            limits.append(max(LEAST_ANCHORS, int(pixels / config.start_pixels)))
    most = min(limits, default=0)  # 0: one per voxel that holds points
    anchors = initial_anchors(points, config.voxel, most, config.seed)
    check_box(config, anchors.position, "the anchors that the run begins with")
    mlps = start_mlps(config.start_mlps, rng)
    return new_state(device, config, len(dataset.train), anchors, mlps, rng)


def check_box(config: TrainConfig, position: npt.NDArray[np.float32], whose: str) -> None:
    """Raise UsageError if only the anchors of a box are to learn, and it holds none.

    ``position``: of ``whose``, which the error names, (A, 3), scene units.
    """
    if config.learning_box is not None and not config.learning_box.holds(position).any():
        ends = (",".join(f"{x:.3g}" for x in end) for end in (position.min(0), position.max(0)))
        where = f"which reach from {' to '.join(ends)} in scene units"
        raise UsageError(f"box: {config.box} holds none of {whose}, {where}")


def state_of_scene(
    device: Device, dataset: Dataset, config: TrainConfig, scene: Scene, step: int
) -> RunState:
    """The state of a run that goes on with a trained scene after step number ``step``.

    The moments and statistics are zero, and bits have no price. ``dataset``: views in the scene's
    units; ``config`` is resolved for it.
    """
    rng = np.random.default_rng(config.seed)
    state = new_state(device, config, len(dataset.train), scene.anchors, scene.mlps, rng)
    state.step = state.begun = step
    state.means = Means(step)
    return state


def steps_done(found: RunResult, config: TrainConfig) -> int:
    """The steps of a finished run; UsageError if they are all that ``config`` asks for."""
    steps = int(found.summary["steps"])
    if config.steps <= steps:
        raise UsageError(
            f"steps: {found.folder} has done {steps}, which count; give more than that, or leave "
            "it out"
        )
    return steps


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
        UsageError: the run has done ``config.steps`` already, has positions on another grid, or no
            anchor in the box of what learns.
    """
    found, old = finished_settings(folder)
    steps, scales = steps_done(found, config), found.scene.scales
    if steps > config.switch_step and config.position_q != scales.position:
        raise UsageError(
            f"position_q: positions of {folder} are multiples of 1 / {scales.position:g} already; "
            "leave it and voxel out, or give a later switch_step"
        )
    check_box(config, found.scene.dequantize().anchors.position, f"the anchors of {folder}")
    saved = checkpoints(folder / "checkpoint")[-1:]
    same = found.summary["digest"] == run_digest(dataset, settings_for(dataset, old))
    if same and saved and int(saved[0].stem.removeprefix("step_")) == steps:
        state = load_state(folder / "checkpoint", device, found.summary["digest"])
        if steps < config.switch_step:
            state.known = None  # the anchors change again before the next round that asks
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
