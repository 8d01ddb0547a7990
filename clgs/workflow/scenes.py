"""Scenes on the disk: run folders, .clgs files, decoded .npz archives and 3DGS splats."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clgs.codec.scene_decoder import decode, decode_box
from clgs.codec.sections import BytesSource, FileSource
from clgs.codec.splat_packing import is_splats, unpack
from clgs.data.splats.sog import images_in
from clgs.errors import CodecError, DataError
from clgs.scene.region import Box
from clgs.scene.scene import QuantizedScene, SplatScene
from clgs.scene.storage import load_scene
from clgs.scene.world import in_words
from clgs.workflow.outputs import holds_run

PLAN = "plan.json"
"""The file by which the output folder of `clgs run` is recognised: the plan of that run."""

SPLAT_SUFFIXES = (".ply", ".spz", ".sog", ".splat", ".json")
"""Suffixes of files of ordinary splats; .json is that of a .sog file that is not zipped."""

WRITTEN_ONLY = (".glb", ".html")
"""Suffixes of what `clgs export` writes and clgs does not read."""

UNREAD = (".ksplat", ".rad")
"""Suffixes of splats that clgs does not read."""


def run_folder(scene: Path) -> Path:
    """The run folder that ``scene`` is or lies in.

    If that is the output folder of `clgs run`, it is the folder ``run`` in it.
    """
    folder = scene if scene.is_dir() else scene.parent
    below = folder / "run"
    return below if (folder / PLAN).is_file() and below.is_dir() else folder


def read_scene(path: Path) -> tuple[QuantizedScene, int | None]:
    """The scene and, if it is a bitstream, its size in bytes.

    Raises:
        DataError: there is no scene at ``path``, or it is damaged.
    """
    if path.is_dir():
        return read_run(path)
    check_there(path)
    if path.suffix.lower() == ".npz":
        return load_scene(path), None
    return read_bitstream(path)


def check_there(path: Path) -> None:
    """Raise DataError if there is nothing at ``path``."""
    if not path.exists():
        raise DataError(f"{path}: no such file or folder; name a run folder or a .clgs file")


def read_drawable(path: Path) -> tuple[QuantizedScene | SplatScene, int | None]:
    """The scene, which may be one of ordinary splats, and its size in bytes.

    The scene of a run is read from its .clgs file, if there is one: it is what is shown and scored.

    Raises:
        DataError: there is no scene at ``path``, or it is damaged.
    """
    from clgs.data.splats.gaussians import load_splats, scene_of_packed

    if path.suffix.lower() in SPLAT_SUFFIXES and not path.is_dir():
        return load_splats(path), _splat_bytes(path)
    bitstream = run_folder(path) / "scene.clgs"
    if path.is_dir() and bitstream.is_file():
        return read_bitstream(bitstream)
    if path.is_dir() or not path.exists() or path.suffix.lower() == ".npz":
        return read_scene(path)
    if path.suffix.lower() in WRITTEN_ONLY and path.is_file():
        raise DataError(f"{path}: such files are written, not read; name a .clgs or .ply file")
    if path.suffix.lower() in UNREAD:
        raise DataError(f"{path}: such files are not read; convert it to .ply, .spz or .sog")
    data = read_bytes(path)
    with naming(path):
        if is_splats(data):
            return scene_of_packed(unpack(data), path), len(data)
        return decode(data), len(data)


def describe_splats(path: Path) -> dict[str, Any]:
    """What a file of ordinary splats holds, ready for JSON.

    extent: the corners of the box of all means, in the file's units; origin: what float32 positions
    are relative to while the splats are drawn; world: what these units are, in words.

    Raises:
        DataError: no such file, or it is damaged.
    """
    from clgs.data.splats.gaussians import load_splats

    scene = load_splats(path)
    mean = scene.transform.to_world(scene.gaussians.mean.astype(np.float64))
    return {
        "bytes": _splat_bytes(path),
        "splats": len(mean),
        "degree": scene.gaussians.degree,
        "antialiased": scene.gaussians.antialiased,
        "extent": {"least": mean.min(axis=0).tolist(), "greatest": mean.max(axis=0).tolist()},
        "world": in_words(scene.transform.frame, scene.transform.place),
        "origin": list(scene.transform.centre),
        "near": scene.settings.near,
    }


def _splat_bytes(path: Path) -> int:
    """The bytes of a file of splats, and of those that belong to it."""
    files = [path, *(images_in(path.parent) if path.suffix.lower() == ".json" else [])]
    return sum(file.stat().st_size for file in files)


def read_run(folder: Path) -> tuple[QuantizedScene, int | None]:
    """The scene of a finished run, or of the output of `clgs run`, and its bitstream's size."""
    folder = run_folder(folder)
    if not (folder / "scene.npz").exists():
        raise DataError(f"{folder}: holds no scene.npz; {instead(folder)}")
    bitstream = folder / "scene.clgs"
    size = bitstream.stat().st_size if bitstream.exists() else None
    return load_scene(folder / "scene.npz"), size


def instead(folder: Path) -> str:
    """What to do with a folder that holds no scene."""
    if any((place / PLAN).is_file() for place in (folder, folder.parent)):
        return "let `clgs run` finish (--resume)"
    if (folder / "config.toml").exists():
        return "let `clgs train` finish (--resume)"
    return "name a run folder; a data set is trained first (`clgs train`)"


def read_bitstream(
    path: Path, threads: int | None = None, layers: int | None = None
) -> tuple[QuantizedScene, int]:
    """The scene in a .clgs file, or ``layers`` of it, and the file's size.

    Raises:
        DataError: there is no file, or it is a folder.
        CodecError: it is not a .clgs file, or is damaged.
    """
    data = read_bytes(path)
    with naming(path):
        return decode(data, threads, layers), len(data)


def read_box(
    path: Path, box: Box, threads: int | None, layers: int | None = None
) -> tuple[QuantizedScene, int, int]:
    """The scene in a box of a .clgs file, the bytes that were read, and the file's size.

    Raises:
        DataError: there is no file, or it is a folder.
        CodecError: it is not a .clgs file, or what was read is damaged.
    """
    if stat.S_ISFIFO(_mode(path)):
        data = path.read_bytes()
        with naming(path):
            return decode_box(BytesSource(data), box, threads, layers), len(data), len(data)
    with _readable(path), path.open("rb", buffering=0) as file, naming(path):
        source = FileSource(file)
        scene = decode_box(source, box, threads, layers)
        return scene, source.bytes_read, source.size


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let a CodecError name the file."""
    try:
        yield
    except CodecError as error:
        raise CodecError(f"{path}: {error}") from error


def read_bytes(path: Path) -> bytes:
    """All of a .clgs file; it may come through a pipe.

    Raises:
        DataError: there is no file, or it is neither a file nor a pipe.
    """
    _mode(path)
    with _readable(path):
        return path.read_bytes()


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Let a lack of permission be a DataError."""
    try:
        yield
    except PermissionError:
        raise DataError(f"{path}: may not be read; give yourself the permission") from None


def _mode(path: Path) -> int:
    """The mode of a file or pipe."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        remedy = "`clgs encode` and `clgs pack` make some"
        if path.parts[0] in ("http:", "https:"):
            remedy = "download it, or read the address by clgs.decode in Python"
        raise DataError(f"{path}: no such file; {remedy}") from None
    if stat.S_ISDIR(mode):
        file = path / "scene.clgs"
        remedy = instead(path) if holds_run(path) else "name a .clgs file"
        if file.is_file():
            remedy = f"name a .clgs file, such as {file}"
        raise DataError(f"{path}: is a folder; {remedy}")
    if not (stat.S_ISREG(mode) or stat.S_ISFIFO(mode)):
        raise DataError(f"{path}: is neither a file nor a pipe; name a .clgs file")
    return mode
