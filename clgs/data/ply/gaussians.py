"""Ordinary Gaussians to render: from 3DGS PLY files and from what `clgs pack` made of them.

Properties: x y z, f_dc_0 to 2, f_rest_* (the rest of the coefficients, all of a channel before the
next channel's), opacity (logit), scale_0 to 2 (log), rot_0 to 3 (w x y z). Others are passed over.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.arguments import as_path
from clgs.codec.splat_packing import QuantizedSplats, unpack
from clgs.data.ply.integer_splats import FEATURE_OF_ANCHORS, POSITION, ROTATION, SCALE
from clgs.data.ply.table import read_ply
from clgs.errors import CodecError, DataError
from clgs.scene.gaussians import DEGREES, HostGaussians, OrdinaryGaussians
from clgs.scene.scene import SplatScene

DC = [f"f_dc_{i}" for i in range(3)]
REST = "f_rest_"

Columns = Mapping[str, npt.NDArray[Any]]

_log = logging.getLogger(__name__)


def load_splats(path: Path | str) -> SplatScene:
    """Ordinary Gaussians to render: a 3DGS PLY file, or a .clgs file of ``clgs pack``.

    They are in the units of their data set, over black.

    Raises:
        DataError: no such file, or it is damaged, lacks a property or holds something else.
    """
    path = as_path("path", path)
    if path.suffix.lower() != ".clgs":
        return SplatScene(read_gaussians(path))
    try:
        return SplatScene(gaussians_of_splats(unpack(path.read_bytes()), path))
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; name a .ply or .clgs file") from None
    except CodecError as error:
        raise CodecError(f"{path}: {error}") from error


def read_gaussians(path: Path | str) -> HostGaussians:
    """The Gaussians of an ordinary 3DGS PLY file.

    Those with a number that is not finite are left out, with a warning. There is one, too, for
    rotations that are none.

    Raises:
        DataError: no such file, or it lacks a property.
    """
    path = as_path("path", path)
    columns = read_ply(path).columns
    if FEATURE_OF_ANCHORS in columns:
        raise DataError(
            f"{path}: holds anchors, no splats; `clgs encode` makes a .clgs file of it first"
        )
    return gaussians_of(columns, path)


def gaussians_of_splats(splats: QuantizedSplats, path: Path) -> HostGaussians:
    """The Gaussians of packed splats; ``path`` is named in errors.

    Raises:
        DataError: a property is missing.
    """
    pairs = enumerate(zip(splats.names, splats.steps, strict=True))
    return gaussians_of({name: splats.values[:, i] * step for i, (name, step) in pairs}, path)


def lacking(names: Collection[str]) -> list[str]:
    """What a file with the properties ``names`` lacks to be one of 3DGS splats."""
    return [name for name in (*POSITION, *DC, "opacity", *SCALE, *ROTATION) if name not in names]


def gaussians_of(columns: Columns, path: Path) -> HostGaussians:
    """The Gaussians of columns (N,) by name of the property; ``path`` is named in errors.

    Raises:
        DataError: a property is missing, or there are no splats.
    """
    rest = [f"{REST}{i}" for i in range(sum(name.startswith(REST) for name in columns))]
    if missing := [*lacking(columns), *(name for name in rest if name not in columns)]:
        raise DataError(f"{path}: property {missing[0]} is missing; these are no 3DGS splats")
    if len(rest) % 3 or 1 + len(rest) // 3 not in DEGREES:
        raise DataError(
            f"{path}: {len(rest)} properties {REST}*; 0, 9, 24 or 45 make a whole degree"
        )

    def stack(names: list[str]) -> npt.NDArray[np.float32]:
        with np.errstate(over="ignore", invalid="ignore"):
            rows = [columns[name].astype(np.float32) for name in names]
        return np.ascontiguousarray(np.stack(rows, axis=1))

    mean = stack(POSITION)
    sh = stack([*DC, *rest])
    count = len(mean)
    higher = sh[:, 3:].reshape(count, 3, len(rest) // 3).transpose(0, 2, 1)
    found = OrdinaryGaussians(
        mean,
        stack(SCALE),
        stack(ROTATION),
        stack(["opacity"])[:, 0],
        np.ascontiguousarray(np.concatenate([sh[:, None, :3], higher], axis=1)),
    )
    found = _finite(found, path)
    if lost := int((~found.rotation.any(axis=1)).sum()):
        text = "%s: %d of %d splats have a rotation of length 0, so that they cannot be seen"
        _log.warning(text, path, lost, len(found))
    if not len(found):
        raise DataError(f"{path}: holds no splats that can be drawn; write it again with some")
    return found


def _finite(gaussians: HostGaussians, path: Path) -> HostGaussians:
    """The Gaussians whose numbers are all finite."""
    good = np.ones(len(gaussians), np.bool_)
    for _, array in gaussians.items():
        good &= np.isfinite(array).all(axis=tuple(range(1, array.ndim)))
    if good.all():
        return gaussians
    lost = len(good) - int(good.sum())
    _log.warning("%s: %d of %d splats have numbers that are not finite and are left out",
                 path, lost, len(good))  # fmt: skip
    return gaussians.map(lambda array: array[good])
