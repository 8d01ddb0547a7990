"""The options of `clgs render` for clips: a path, its frames, and what each shows."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options.view import check_photos_there, named_path, positive_int
from clgs.cli.tell import tell
from clgs.errors import UsageError

if TYPE_CHECKING:
    from clgs.data.dataset import Dataset
    from clgs.export.clip.framing import Framing
    from clgs.scene.camera import Camera
    from clgs.scene.scene import QuantizedScene, SplatScene

PATHS = ("orbit", "spiral", "interpolate")
FRAMES = 120
FPS = 30.0
SIZE = 800, 600
MAX_SIDE = 16384
OTHER_VIDEOS = (".mov", ".webm", ".gif", ".avi", ".mkv", ".m4v")
"""Suffixes of videos that are not written."""

UPS = {
    f"{sign}{axis}": tuple((-1.0 if sign else 1.0) * (axis == other) for other in "xyz")
    for axis in "xyz"
    for sign in ("", "-")
}
"""The axes that --up names."""


def add_path_options(parser: argparse.ArgumentParser) -> None:
    """Add --path and what belongs to it."""
    group = parser.add_argument_group("a clip along a path")
    group.add_argument(
        "--path",
        metavar="orbit|spiral|interpolate|F.json",
        help="render a clip: around the scene, on small circles before it, through the training "
        "photos, or along a camera path in nerfstudio's form; -o is an .mp4 file (extra "
        "clgs[video]) or a folder for PNG files",
    )
    group.add_argument(
        "--frames", type=positive_int, metavar="N", help=f"(default: {FRAMES}, or those of F.json)"
    )
    group.add_argument(
        "--fps", type=_rate, metavar="X", help=f"frames a second (default: {FPS:g}, or F.json's)"
    )
    group.add_argument(
        "--size",
        type=_size,
        metavar="WxH",
        help="pixels (default: of the photos with --data, of F.json, else "
        f"{SIZE[0]}x{SIZE[1]}); the vertical angle of view stays",
    )
    group.add_argument(
        "--up",
        choices=UPS,
        metavar="AXIS",
        help="up without --data: x, y, z, -x, -y or -z (default: a guess)",
    )
    group.add_argument(
        "--save-path", type=named_path, metavar="F.json", help="write the cameras to F.json, too"
    )


def add_kind_options(parser: argparse.ArgumentParser) -> None:
    """Add --depth and --opacity."""
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--depth",
        dest="kind",
        action="store_const",
        const="depth",
        default="color",
        help="pictures of depth, near ones light; in a folder also NAME.npy, the depths in the "
        "data set's units (float32)",
    )
    kind.add_argument(
        "--opacity",
        dest="kind",
        action="store_const",
        const="opacity",
        help="pictures of opacity: white where nothing behind the scene shows through",
    )


def check_path(args: argparse.Namespace) -> None:
    """Refuse, before long work, options that do not go together.

    Raises:
        UsageError: names the option.
    """
    if args.path is None:
        _check_views(args)
    else:
        _check_clip(args)


def _check_views(args: argparse.Namespace) -> None:
    """Of pictures of the photos' views."""
    if name := _given(args, "frames", "fps", "size", "up", "save_path"):
        raise UsageError(f"{name}: belongs to a clip; give --path too")
    if args.output.suffix.lower() in (".mp4", *OTHER_VIDEOS):
        raise UsageError(f"{args.output}: a video is a clip; give --path, or name a folder")
    if args.data is None:
        check_photos_there(args.scene)
        raise UsageError("nothing to render: name the photos with --data, or a path with --path")


def _check_clip(args: argparse.Namespace) -> None:
    """Of a clip along a path."""
    if args.path not in PATHS and Path(args.path).suffix.lower() != ".json":
        raise UsageError(f"--path {args.path}: is not {', '.join(PATHS)} or a .json file")
    if args.path == "interpolate" and args.data is None:
        raise UsageError("--path interpolate: goes through photos; name them with --data")
    if args.save_path is not None and args.save_path.suffix.lower() != ".json":
        raise UsageError(f"{args.save_path}: a camera path is a .json file; name it so")
    _check_cameras(args)


def _check_cameras(args: argparse.Namespace) -> None:
    """Of the cameras of a clip: options that would have no effect."""
    named = args.path in PATHS
    if args.up is not None and (args.data is not None or not named):
        raise UsageError("--up: cameras say what is up; leave it out")
    if args.split is not None:
        raise UsageError("--split: a clip shows no views of the data set; leave it out")
    name = _given(args, "downscale", "max_size")
    if name and not (named and args.data is not None):
        raise UsageError(f"{name}: no photos give the frames their size; use --size")


def _given(args: argparse.Namespace, *names: str) -> str | None:
    """The first of the options ``names`` that is given, as it is typed; None if none is."""
    found = (name for name in names if getattr(args, name) is not None)
    return next((f"--{name.replace('_', '-')}" for name in found), None)


def make_path(
    args: argparse.Namespace, scene: QuantizedScene | SplatScene, dataset: Dataset | None
) -> tuple[list[Camera], float]:
    """The cameras of the frames, in scene units, and frames a second.

    Raises:
        DataError: the file of the path is missing or damaged, or the data set has no cameras.
    """
    if args.path not in PATHS:
        return _path_of_file(args, scene)
    from clgs.export.clip.paths import orbit, spiral, through_photos

    frames, fps = args.frames or FRAMES, args.fps or FPS
    if args.path == "interpolate":
        assert dataset is not None
        cameras = through_photos([view.camera for view in dataset.train], frames)
        return [_resized(camera, args.size) for camera in cameras], fps
    make = orbit if args.path == "orbit" else spiral
    return make(_framing(args, scene, dataset), frames), fps


def _framing(
    args: argparse.Namespace, scene: QuantizedScene | SplatScene, dataset: Dataset | None
) -> Framing:
    from dataclasses import replace

    import numpy as np

    from clgs.export.clip.framing import frame_cameras, frame_scene

    up = None if args.up is None else np.array(UPS[args.up])
    framing = frame_scene(scene, args.size or SIZE, up)
    if dataset is not None:
        framing = frame_cameras([view.camera for view in dataset.train], framing)
    elif up is None:
        guess = next(name for name, axis in UPS.items() if np.array_equal(axis, framing.up))
        tell(f"clgs: up is taken to be {guess}; --up or --data may correct it")
    return replace(framing, size=args.size) if args.size else framing


def _path_of_file(
    args: argparse.Namespace, scene: QuantizedScene | SplatScene
) -> tuple[list[Camera], float]:
    from clgs.data.repose import move_camera
    from clgs.export.clip.camera_path import read_camera_path
    from clgs.export.clip.paths import interpolate
    from clgs.scene.scene import SceneTransform

    found = read_camera_path(Path(args.path))
    cameras = [move_camera(camera, SceneTransform(), scene.transform) for camera in found.cameras]
    if args.frames is not None and args.frames != len(cameras):
        cameras = interpolate(cameras, args.frames)
    return [_resized(camera, args.size) for camera in cameras], args.fps or found.fps or FPS


def _resized(camera: Camera, size: tuple[int, int] | None) -> Camera:
    """With another raster, the same vertical angle of view, and pixels of the same shape."""
    from dataclasses import replace

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


def _size(text: str) -> tuple[int, int]:
    words = text.lower().split("x")
    if len(words) != 2 or not all(word.isdecimal() and len(word) < 6 for word in words):
        raise argparse.ArgumentTypeError(f"{text} is not WIDTHxHEIGHT, such as 800x600")
    width, height = map(int, words)
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise argparse.ArgumentTypeError(f"{text}: sides are 1 to {MAX_SIDE} pixels")
    return width, height


def _rate(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.1 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"{text} is not a number from 0.1 to 1000")
    return value
