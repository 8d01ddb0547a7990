"""The cameras of a clip: around the scene, through the photos, or from a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from clgs.data.dataset import Dataset
from clgs.data.origin import move_camera
from clgs.errors import UsageError
from clgs.exports.camera_path import interpolate, orbit, read_camera_path, spiral, through_photos
from clgs.exports.framing import frame_cameras, frame_scene
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene, SceneTransform, SplatScene
from clgs.workflow.events import Note, OnEvent
from clgs.workflow.options import FPS, FRAMES, PATHS, SIZE, UPS, PathOptions, ViewOptions


def check_path_name(option: str, name: str) -> None:
    """Raise UsageError unless ``name``, the value of ``option``, can be the path of a clip."""
    if name not in PATHS and Path(name).suffix.lower() != ".json":
        raise UsageError(f"{option} {name}: is not {', '.join(PATHS)} or a .json file")


def check_clip(path: PathOptions, views: ViewOptions, save_path: Path | None) -> None:
    """Raise UsageError if options do not go together, or would have no effect."""
    check_path_name("--path", path.name)
    named = path.name in PATHS
    if path.name == "interpolate" and views.data is None:
        raise UsageError("--path interpolate: goes through photos; name them with --data")
    if save_path is not None and save_path.suffix.lower() != ".json":
        raise UsageError(f"{save_path}: a camera path is a .json file; name it so")
    if path.up is not None and (views.data is not None or not named):
        raise UsageError("--up: cameras say what is up; leave it out")
    if views.split is not None:
        raise UsageError("--split: a clip shows no views of the data set; leave it out")
    if not (named and views.data is not None):
        for option, value in (("--downscale", views.downscale), ("--max-size", views.max_size)):
            if value is not None:
                raise UsageError(f"{option}: no photos give the frames their size; use --size")


def make_path(
    path: PathOptions,
    scene: QuantizedScene | SplatScene,
    dataset: Dataset | None,
    on_event: OnEvent,
) -> tuple[list[Camera], float]:
    """The cameras of the frames, in scene units, and frames per second.

    Raises:
        DataError: the file of the path is missing or damaged, or the data set has no cameras.
    """
    fps = path.fps or FPS
    if path.name not in PATHS:
        found, own_fps = read_camera_path(Path(path.name))
        moved = [move_camera(one, SceneTransform(), scene.transform) for one in found]
        if path.frames is not None and path.frames != len(moved):
            moved = interpolate(moved, path.frames)
        return [_resized(one, path.size) for one in moved], path.fps or own_fps or FPS
    frames = path.frames or FRAMES
    if path.name == "interpolate":
        assert dataset is not None
        cameras = through_photos([view.camera for view in dataset.train], frames)
        return [_resized(one, path.size) for one in cameras], fps
    up = None if path.up is None else np.array(UPS[path.up])
    framing = frame_scene(scene, path.size or SIZE, up)
    if dataset is not None:
        framing = frame_cameras([view.camera for view in dataset.train], framing)
    elif up is None:
        guess = next(name for name, axis in UPS.items() if np.array_equal(axis, framing.up))
        on_event(Note(f"up is taken to be {guess}; --up or --data may correct it"))
    if path.size:
        framing = replace(framing, size=path.size)
    return (orbit if path.name == "orbit" else spiral)(framing, frames), fps


def _resized(camera: Camera, size: tuple[int, int] | None) -> Camera:
    """A camera with another raster, the same vertical angle of view and pixels of that shape."""
    if size is None:
        return camera
    width, height = size
    times = height / camera.height
    return replace(
        camera,
        fx=camera.fx * times,
        fy=camera.fy * times,
        cx=width / 2,
        cy=height / 2,
        width=width,
        height=height,
    )
