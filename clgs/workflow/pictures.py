"""Pictures of a scene: of a data set's views, or of the frames of a clip.

The cameras of a clip go around the scene, through the photos, or are from a file.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.data.dataset import Dataset
from clgs.data.origin import move_camera
from clgs.errors import UsageError
from clgs.exports.camera_path import (
    interpolate,
    orbit,
    read_camera_path,
    spiral,
    through_photos,
    write_camera_path,
)
from clgs.exports.framing import frame_cameras, frame_scene
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
from clgs.scene.scene import QuantizedScene, SceneTransform, SplatScene, drawable
from clgs.train.quality.scores import to_8bit
from clgs.workflow.events import Note, OnEvent, ignore, track
from clgs.workflow.options import (
    FPS,
    FRAMES,
    PATHS,
    SIZE,
    UPS,
    PathOptions,
    ViewOptions,
    refuse,
)
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
        given = {"downscale": views.downscale, "max_size": views.max_size}
        refuse(given, "no photos give the frames their size; use --size")


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
