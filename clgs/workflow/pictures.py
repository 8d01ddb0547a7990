"""Pictures of a scene: of a data set's views, or of the frames of a clip."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.data.origin import move_camera
from clgs.errors import UsageError
from clgs.exports.camera_path import write_camera_path
from clgs.exports.pictures import (
    SUFFIX,
    Picture,
    heat,
    load_writer,
    mp4_writer,
    picture_names,
    save_png,
)
from clgs.files import atomic_write, folder_to_fill
from clgs.opencl.device import Device
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import SceneTransform, drawable
from clgs.train.quality.scores import to_8bit
from clgs.workflow.camera_paths import check_clip, make_path
from clgs.workflow.events import OnEvent, ignore, track
from clgs.workflow.options import PathOptions, ViewOptions
from clgs.workflow.outputs import check_apart, check_new, check_picture_folder
from clgs.workflow.scenes import check_there, read_drawable
from clgs.workflow.views import (
    check_photos_there,
    drawing_options,
    known_data,
    load_views,
    over_background,
    select_views,
)

OTHER_VIDEOS = (".mov", ".webm", ".gif", ".avi", ".mkv", ".m4v")
"""Suffixes of videos that are not written."""

RANGE_CAMERAS = 12
"""The depths that this many cameras see give the range of the colors of all pictures."""

RANGE_REDUCTION = 8
RANGE_PERCENTILES = 2, 98
"""Percentiles of the depths that get the lightest and the darkest color."""

SEEN = 0.5
"""Least opacity of a pixel whose depth counts for that range."""


@dataclass(frozen=True)
class DrawnPicture:
    """A picture (H, W, 3) uint8 and, if it shows depth, the depths (H, W) float32."""

    picture: Picture
    depth: npt.NDArray[np.float32] | None = None


Draw = Callable[[Camera], DrawnPicture]


@dataclass(frozen=True)
class Clip:
    """A clip that was written: its file or folder, its frames, their size, frames per second."""

    path: Path
    frames: int
    width: int
    height: int
    fps: float


def drawer(renderer: Renderer, kind: str, cameras: Sequence[Camera]) -> Draw:
    """A function that draws pictures of one kind: "color", "depth" or "opacity".

    Depth is shown from light (near) to dark (far), evenly in 1 / depth, and black where nothing is.
    The range is the same for all pictures; ``cameras``, those of all pictures, give it.
    """
    if kind == "color":
        return lambda camera: DrawnPicture(to_8bit(renderer.render(camera)))
    if kind == "opacity":
        return lambda camera: DrawnPicture(
            to_8bit(np.repeat(renderer.depth(camera).opacity[None], 3, axis=0))
        )
    found: list[npt.NDArray[np.float32]] = []
    for camera in cameras[:: max(1, len(cameras) // RANGE_CAMERAS)]:
        seen = renderer.depth(camera.reduced(RANGE_REDUCTION))
        found.append(seen.depth[seen.opacity > SEEN])
    depths = np.concatenate(found)
    near, far = map(float, np.percentile(depths, RANGE_PERCENTILES) if len(depths) else (1, 2))
    far = max(far, near * 1.001)

    def draw(camera: Camera) -> DrawnPicture:
        seen = renderer.depth(camera)
        depth = np.clip(seen.depth.astype(np.float64), near, far)
        closeness = (1 / depth - 1 / far) / (1 / near - 1 / far)
        shown = heat(0.1 + 0.9 * closeness) * seen.opacity[..., None]
        return DrawnPicture(np.asarray(np.rint(np.clip(shown, 0, 255)), np.uint8), seen.depth)

    return draw


def render_views(
    scene: Path,
    output: Path,
    views: ViewOptions,
    *,
    kind: str = "color",
    overwrite: bool = False,
    on_event: OnEvent = ignore,
) -> int:
    """Write pictures of the data set's views to the folder ``output``; their number.

    The PNG files are named after the photos; depths go to .npy files too. ``kind`` is "color",
    "depth" or "opacity". With ``overwrite`` pictures of the same names are replaced.

    Raises:
        UsageError: the data set is not known, or ``output`` is not fit for pictures.
        ExistsError: a picture exists.
        DataError: the scene or the data set is damaged.
        BudgetError: ``views.max_memory`` is too small.
    """
    if views.data is None:
        check_there(scene)
    data = views.data or known_data(scene)
    if data is None:
        check_photos_there(scene)
        raise UsageError("nothing to render: name the photos with --data, or a path with --path")
    check_picture_folder(output)
    check_apart(output, data)
    found, _ = read_drawable(scene)
    chosen = select_views(scene, found, replace(views, data=data), on_event)
    names = picture_names([view.name for view in chosen])
    if output.exists():
        for name in names:
            check_new(output / name, overwrite)
    shown = drawable(over_background(found, views.background))
    renderer = Renderer(Device(views.device), shown, drawing_options(scene, views, found))
    renderer.check_budget((view.name, view.camera) for view in chosen)
    draw = drawer(renderer, kind, [view.camera for view in chosen])
    pairs = zip(names, chosen, strict=True)
    with folder_to_fill(output):
        for name, view in track(pairs, "rendering", len(names), on_event):
            _save(output / name, draw(view.camera), found.transform)
    return len(chosen)


def render_clip(
    scene: Path,
    output: Path,
    path: PathOptions,
    views: ViewOptions,
    *,
    kind: str = "color",
    save_path: Path | None = None,
    overwrite: bool = False,
    on_event: OnEvent = ignore,
) -> Clip:
    """Write a clip along a path, as an .mp4 file or as PNG files in a folder.

    ``kind`` is "color", "depth" or "opacity". ``save_path``, a .json file, receives the cameras.
    With ``overwrite`` the video, or an older clip in the folder, is replaced.

    Raises:
        UsageError: options contradict each other, or ``output`` is not fit for a clip.
        ExistsError: an output exists.
        DataError: the scene, the data set or the file of the path is damaged.
        BudgetError: ``views.max_memory`` is too small.
    """
    if views.data is None:
        check_there(scene)
        up = path.up and path.name != "interpolate"  # it stands in for the photos' up
        views = replace(views, data=None if up else known_data(scene))
    check_clip(path, views, save_path)
    if save_path is not None:
        check_new(save_path, overwrite, scene, Path(path.name))
    is_video = _check_clip_output(output, overwrite, scene)
    found, _ = read_drawable(scene)
    dataset = load_views(scene, found, views, on_event) if views.data is not None else None
    cameras, fps = make_path(path, found, dataset, on_event)
    width, height = cameras[0].width, cameras[0].height
    if is_video and (width % 2 or height % 2):
        if path.size or min(width, height) < 2:
            raise UsageError(f"--size {width}x{height}: a video needs even numbers")
        width, height = width - width % 2, height - height % 2
        cameras = [replace(camera, width=width, height=height) for camera in cameras]
    shown = drawable(over_background(found, views.background))
    renderer = Renderer(Device(views.device), shown, drawing_options(scene, views, found))
    renderer.check_budget((f"frame {i}", camera) for i, camera in enumerate(cameras))
    draw = drawer(renderer, kind, cameras)
    if is_video:
        with mp4_writer(output, (width, height), fps) as add:
            for camera in track(cameras, "rendering", len(cameras), on_event):
                add(draw(camera).picture)
    else:
        with folder_to_fill(output):
            for number, camera in enumerate(track(cameras, "rendering", len(cameras), on_event)):
                _save(output / f"frame_{number:05}.png", draw(camera), found.transform)
        for older in _frames_in(output)[len(cameras) :]:
            older.unlink()
            older.with_suffix(".npy").unlink(missing_ok=True)
    if save_path is not None:
        world = [move_camera(camera, found.transform, SceneTransform()) for camera in cameras]
        write_camera_path(save_path, world, fps)
    return Clip(output, len(cameras), width, height, fps)


def _check_clip_output(output: Path, overwrite: bool, scene: Path) -> bool:
    """Refuse an output that cannot be written; whether it is a video."""
    suffix = output.suffix.lower()
    if suffix in OTHER_VIDEOS:
        raise UsageError(f"{output}: a video is an {SUFFIX} file; name it so")
    if suffix == SUFFIX:
        check_new(output, overwrite, scene)
        load_writer()
        return True
    check_picture_folder(output)
    for picture in _frames_in(output)[:1]:
        check_new(picture, overwrite)
    return False


def _frames_in(folder: Path) -> list[Path]:
    """The pictures of a clip in ``folder``, in order."""
    return sorted(folder.glob(f"frame_{'[0-9]' * 5}.png"))


def _save(path: Path, drawn: DrawnPicture, transform: SceneTransform) -> None:
    """Write the picture to ``path`` (.png), and its depths, if it has some, to a .npy next to it.

    The depths in the file are in the data set's units.
    """
    save_png(path, drawn.picture)
    depths = path.with_suffix(".npy")
    if drawn.depth is None:
        depths.unlink(missing_ok=True)  # of an older picture of this name
    else:
        buffer = io.BytesIO()
        np.save(buffer, (drawn.depth / transform.scale).astype(np.float32), allow_pickle=False)
        atomic_write(depths, buffer.getvalue())
