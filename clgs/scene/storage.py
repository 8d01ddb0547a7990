"""A quantised scene as a NumPy archive: exact, readable without this package, no pickles."""

from __future__ import annotations

import io
import lzma
import math
import os
import struct
import tokenize
import zipfile
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from clgs.arguments import as_path, check_type
from clgs.errors import DataError, UsageError
from clgs.files import atomic_write, check_declared
from clgs.scene.anchors import FIELDS, Anchors, QuantizationScales
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.scene import QuantizedScene, RenderSettings, SceneTransform, check_ranges
from clgs.shapes import Shapes

GROUPS: dict[str, Any] = {
    "scales": QuantizationScales(),
    "settings": RenderSettings(),
    "transform": SceneTransform(),
}
ARRAY_NAMES = (
    *FIELDS,
    "mlps",
    *(f"{group}.{field}" for group, default in GROUPS.items() for field in asdict(default)),
)
"""What a reader needs; ``world_position`` is for others."""

LATER = "transform.frame", "transform.place", "settings.photos"
"""Fields that archives lack if they say nothing, as older ones do."""

DAMAGE = (
    *(ValueError, TypeError, KeyError, AttributeError, OSError, EOFError, MemoryError),
    *(RuntimeError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error),
    *(SyntaxError, tokenize.TokenError),
)
"""What NumPy and zipfile raise on damaged archives; NotImplementedError is a RuntimeError."""

SUFFIX = ".npz"
"""What the name of an archive ends in."""

MOST_FOR_A_BYTE = 1032
"""Bytes that one byte of an archive expands to, at most, in the usual compression (deflate)."""


def save_scene(path: Path | str, scene: QuantizedScene) -> None:
    """Write integers, float32 MLP weights and settings to ``path`` (.npz), atomically.

    For readers without this package it also holds ``world_position`` (A, 3) float64, the anchor
    positions in the units of the input data.

    Raises:
        UsageError: the name does not end in .npz.
        TypeError: ``scene`` is no quantised scene.
        OutputError, OSError: as of :func:`clgs.files.atomic_write`.
    """
    path = as_path("path", path)
    if path.suffix.lower() != SUFFIX:
        raise UsageError(f"{path}: a scene is kept as a NumPy archive; name it {SUFFIX}")
    check_type("scene", scene, QuantizedScene, "one comes from clgs.train_scene or clgs.decode")
    arrays: dict[str, Any] = dict(scene.anchors.items())
    arrays["mlps"] = scene.mlps.flat
    for group in GROUPS:
        for name, value in asdict(getattr(scene, group)).items():
            if f"{group}.{name}" in LATER and value == getattr(GROUPS[group], name):
                continue
            arrays[f"{group}.{name}"] = np.array(value, np.float64)
    arrays["world_position"] = scene.world_position()
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    atomic_write(path, buffer.getvalue())


def load_scene(path: Path | str) -> QuantizedScene:
    """Read what :func:`save_scene` wrote.

    Raises:
        DataError: the file is missing or damaged, lacks an array, or holds a number that makes no
            sense.
        MemoryError: there is no room for the scene.
    """
    path = as_path("path", path)
    try:
        with path.open("rb") as file, load_archive(file) as archive:
            arrays = {name: archive[name] for name in ARRAY_NAMES if name in archive.files}
        return _scene(arrays)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; name the scene.npz of a run") from None
    except IsADirectoryError:
        raise DataError(f"{path}: is a folder; name the scene.npz of a run") from None
    except PermissionError:
        raise DataError(f"{path}: may not be read; give yourself the permission") from None
    except DAMAGE as error:
        if isinstance(error, MemoryError):
            # No damage, if the archive may hold the array that memory had no room for.
            shape, dtype = getattr(error, "shape", ()), getattr(error, "dtype", np.dtype(np.int8))
            if math.prod(shape) * dtype.itemsize <= MOST_FOR_A_BYTE * path.stat().st_size:
                raise
        problem = describe_damage(error)
        remedy = "clgs.decode reads it" if path.suffix == ".clgs" else "write the file again"
        raise DataError(f"{path}: not a scene archive ({problem}); {remedy}") from None


def load_archive(file: BinaryIO) -> Any:
    """What np.load gives for an open file, without pickles; nothing is decompressed yet.

    Raises:
        ValueError: the arrays that an archive declares are too large for a file of its size.
        DAMAGE: as of np.load.
    """
    if zipfile.is_zipfile(file):
        with zipfile.ZipFile(file) as archive:
            check_members(archive, file.seek(0, os.SEEK_END))
    file.seek(0)
    return np.load(file, allow_pickle=False)


def check_members(archive: zipfile.ZipFile, size: int) -> None:
    """Check what a zip archive of ``size`` bytes declares, which may be wrong.

    Of members that are compressed by bzip2 or LZMA, zipfile unpacks as much as there is.

    Raises:
        ValueError: its members are too large for it, or are compressed in such a way.
    """
    for member in archive.infolist():
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"{member.filename} is compressed, but not by deflate")
    check_declared(sum(member.file_size for member in archive.infolist()), size)


def describe_damage(error: BaseException) -> str:
    """What one of DAMAGE says of an archive, in one line and in words for its owner."""
    message = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    if "allow_pickle" in message:
        return "no NumPy archive of plain numbers; pickles are never read"
    if "context manager" in message:
        return "a single array"
    return " ".join(message.split()) or type(error).__name__


def _scene(arrays: dict[str, Any]) -> QuantizedScene:
    """The scene in ``arrays``; raises ValueError or TypeError, naming the array."""
    for name in ARRAY_NAMES:
        if name not in LATER and not isinstance(arrays.get(name), np.ndarray):
            raise ValueError(f"array {name} is missing")
    Shapes().check("mlps", arrays["mlps"], str(MLP_SIZE), np.float32)
    if not np.isfinite(arrays["mlps"]).all():
        raise ValueError("mlps: a weight is not finite")
    scales, settings, transform = (_group(arrays, group) for group in GROUPS)
    scene = QuantizedScene(
        Anchors(*(arrays[name] for name in FIELDS)),
        Mlps(arrays["mlps"]),
        QuantizationScales(**scales),
        RenderSettings(**settings),
        SceneTransform(**transform),
    )
    check_ranges(scene.scales, scene.transform, scene.settings)
    return scene


def _group(arrays: dict[str, Any], group: str) -> dict[str, Any]:
    """The fields of one of GROUPS: numbers and tuples of numbers, as its defaults are."""
    values = {}
    for field, default in asdict(GROUPS[group]).items():
        if f"{group}.{field}" not in arrays:
            values[field] = default
            continue
        array = arrays[f"{group}.{field}"]
        spec = " ".join(map(str, np.shape(default)))
        Shapes().check(f"{group}.{field}", array, spec, np.float64)
        values[field] = tuple(array.tolist()) if array.ndim else float(array)
    return values
