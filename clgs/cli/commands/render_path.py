"""`clgs render --path`: a clip, as a video or as a folder of pictures."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.counted import counted
from clgs.cli.options.output import check_new, check_picture_folder

if TYPE_CHECKING:
    from clgs.cli.frames import Frame
    from clgs.scene.camera import Camera
    from clgs.scene.scene import SceneTransform

Add = Callable[["Frame"], None]


def render_path(args: argparse.Namespace) -> int:
    """Render the clip; exit code 0."""
    from clgs.cli.frames import Frames
    from clgs.cli.options.path import make_path
    from clgs.cli.options.scene import read_drawable
    from clgs.cli.options.view import (
        load_views,
        over_background,
        selected_options,
    )
    from clgs.cli.progress import track
    from clgs.opencl.device import Device
    from clgs.render.renderer import Renderer
    from clgs.scene.scene import drawable

    video = _check_output(args)
    scene, _ = read_drawable(args.scene)
    dataset = load_views(args, scene) if args.data is not None else None
    cameras, fps = make_path(args, scene, dataset)
    if video:
        cameras = _even(args, cameras)
    renderer = Renderer(
        Device(args.device), drawable(over_background(args, scene)), selected_options(args)
    )
    renderer.check_budget((f"frame {i}", camera) for i, camera in enumerate(cameras))
    frames = Frames(renderer, args.kind, cameras)
    sink = _video(args.output, cameras[0], fps) if video else _folder(args, scene.transform)
    with sink as add:
        for camera in track(cameras, "rendering"):
            add(frames.draw(camera))
    if args.save_path is not None:
        _save_path(args.save_path, cameras, scene.transform, fps)
    size = f"{cameras[0].width}x{cameras[0].height}"
    frames_made = counted(len(cameras), "frame")
    print(f"{args.output}: {frames_made} of {size}, {len(cameras) / fps:.1f} s at {fps:g} a second")
    return 0


def _check_output(args: argparse.Namespace) -> bool:
    """Whether the output is a video; refuses, before long work, what cannot be written."""
    from clgs.cli.options.path import OTHER_VIDEOS
    from clgs.errors import UsageError
    from clgs.export.clip.video import SUFFIX, load_writer

    suffix = args.output.suffix.lower()
    if suffix in OTHER_VIDEOS:
        raise UsageError(f"{args.output}: a video is an {SUFFIX} file; name it so")
    if args.save_path is not None:
        check_new(args, args.save_path, args.scene, Path(args.path))
    if suffix == SUFFIX:
        check_new(args, args.output, args.scene)
        load_writer()
        return True
    check_picture_folder(args.output)
    for path in _frames_in(args.output)[:1]:
        check_new(args, path)
    return False


def _even(args: argparse.Namespace, cameras: list[Camera]) -> list[Camera]:
    """A row or column less where a video needs it; refuses odd sizes that were asked for."""
    from clgs.errors import UsageError

    width, height = cameras[0].width, cameras[0].height
    if not (width % 2 or height % 2):
        return cameras
    if args.size or min(width, height) < 2:
        raise UsageError(f"--size {width}x{height}: a video needs even numbers")
    width, height = width - width % 2, height - height % 2
    return [replace(camera, width=width, height=height) for camera in cameras]


@contextmanager
def _video(output: Path, camera: Camera, fps: float) -> Iterator[Add]:
    from clgs.export.clip.video import mp4_writer

    with mp4_writer(output, (camera.width, camera.height), fps) as add:
        yield lambda frame: add(frame.picture)


@contextmanager
def _folder(args: argparse.Namespace, transform: SceneTransform) -> Iterator[Add]:
    from clgs.files import folder_to_fill

    count = 0

    def add(frame: Frame) -> None:
        nonlocal count
        save_frame(args.output / _name(count), frame, transform)
        count += 1

    with folder_to_fill(args.output):
        yield add
    for path in _frames_in(args.output)[count:]:
        path.unlink()
        path.with_suffix(".npy").unlink(missing_ok=True)


def _frames_in(folder: Path) -> list[Path]:
    """The pictures of a clip in ``folder``, in order."""
    return sorted(folder.glob(f"frame_{'[0-9]' * 5}.png"))


def _name(number: int) -> str:
    return f"frame_{number:05}.png"


def save_frame(path: Path, frame: Frame, transform: SceneTransform) -> None:
    """The picture as ``path`` (.png) and its depths, if it has some, as .npy beside it."""
    import io

    import numpy as np

    from clgs.export.image import save_png
    from clgs.files import atomic_write

    save_png(path, frame.picture)
    depths = path.with_suffix(".npy")
    if frame.depth is None:
        depths.unlink(missing_ok=True)  # of an older picture of this name
    else:
        buffer = io.BytesIO()
        np.save(buffer, (frame.depth / transform.scale).astype(np.float32), allow_pickle=False)
        atomic_write(depths, buffer.getvalue())


def _save_path(path: Path, cameras: list[Camera], transform: SceneTransform, fps: float) -> None:
    from clgs.data.repose import move_camera
    from clgs.export.clip.camera_path import write_camera_path
    from clgs.scene.scene import SceneTransform

    world = [move_camera(camera, transform, SceneTransform()) for camera in cameras]
    write_camera_path(path, world, fps)
