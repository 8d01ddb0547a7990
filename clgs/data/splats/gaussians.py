"""Scenes of ordinary Gaussians, from the files of 3DGS trainers and from what `clgs pack` made."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.arguments import as_path
from clgs.codec.splat_packing import QuantizedSplats, unpack
from clgs.constants import LOG_SCALE_LIMIT, NEAR_PLANE
from clgs.data.splats.read import (
    ANTIALIASED,
    DC,
    FEATURE_OF_ANCHORS,
    MARK,
    POSITION,
    REST,
    ROTATION,
    SCALE,
    read_splat_table,
)
from clgs.errors import CodecError, DataError
from clgs.scene.gaussians import DEGREES, OrdinaryGaussians
from clgs.scene.scene import RenderSettings, SceneTransform, SplatScene
from clgs.scene.world import from_text

FINE = 2.0**-10
"""Positions in float32 must be this many times finer than half of the splats are large."""

USUAL_SPREAD = 2.0, 40.0
"""Scenes that spread like this, in their own units, are drawn from the usual near plane on."""

USUAL_LENGTHS = 1e-30, 1e30
"""Quaternions of these lengths are made unit ones where they are drawn, in float32."""

Columns = Mapping[str, npt.NDArray[Any]]

_log = logging.getLogger(__name__)


def load_splats(path: Path | str) -> SplatScene:
    """Ordinary Gaussians to render: a .ply, .spz or .sog file, or a .clgs file of ``clgs pack``.

    They are over black, in the units of their data set; if they lie so far from the origin that
    float32 would move them, the middle is the origin, as ``transform`` says. Those with a number
    that is not finite, or a rotation of length 0, are left out, with a warning.

    Raises:
        DataError: no such file, or it is damaged, lacks a property or holds something else.
    """
    path = as_path("path", path)
    if path.suffix.lower() != ".clgs":
        table = read_splat_table(path)
        columns = dict(table.columns)
        if MARK in table.comments:
            columns[ANTIALIASED] = np.ones(1)
        return scene_of(columns, path, table.comments)
    try:
        return scene_of_packed(unpack(path.read_bytes()), path)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; name a .ply or .clgs file") from None
    except CodecError as error:
        raise CodecError(f"{path}: {error}") from error


def scene_of_packed(splats: QuantizedSplats, path: Path) -> SplatScene:
    """The scene of packed splats; ``path`` is named in errors.

    Raises:
        DataError: a property is missing, or there are no splats.
    """
    pairs = enumerate(zip(splats.names, splats.steps, strict=True))
    return scene_of({name: splats.values[:, i] * step for i, (name, step) in pairs}, path)


def lacking(names: Collection[str]) -> list[str]:
    """What a file with the properties ``names`` lacks to be one of 3DGS splats."""
    return [name for name in (*POSITION, *DC, "opacity", *SCALE, *ROTATION) if name not in names]


def scene_of(columns: Columns, path: Path, comments: Sequence[str] = ()) -> SplatScene:
    """The scene of columns (N,) by name of the property; ``path`` is named in errors.

    ``comments``: one of them may say what the world is.

    Raises:
        DataError: a property is missing, or there are no splats.
    """
    if FEATURE_OF_ANCHORS in columns:
        raise DataError(
            f"{path}: holds anchors, no splats; `clgs encode` makes a .clgs file of it first"
        )
    rest = [f"{REST}{i}" for i in range(sum(name.startswith(REST) for name in columns))]
    if missing := [*lacking(columns), *(name for name in rest if name not in columns)]:
        raise DataError(f"{path}: property {missing[0]} is missing; these are no 3DGS splats")
    if len(rest) % 3 or 1 + len(rest) // 3 not in DEGREES:
        raise DataError(
            f"{path}: {len(rest)} properties {REST}*; 0, 9, 24 or 45 make a whole degree"
        )
    columns = {**columns, **_directions(columns)}
    names = [*POSITION, *DC, *rest, "opacity", *SCALE, *ROTATION]
    with np.errstate(over="ignore", invalid="ignore"):
        single = {name: columns[name].astype(np.float32) for name in names}
    finite = np.all([np.isfinite(column) for column in single.values()], axis=0)
    good = finite & np.any([single[name] for name in ROTATION], axis=0)
    for lost, what in (
        (~finite, "numbers that are not finite"),
        (finite & ~good, "a rotation of length 0"),
    ):
        if lost.any():
            text = "%s: %d of %d splats have %s and are left out"
            _log.warning(text, path, lost.sum(), len(good), what)
    if not good.any():
        raise DataError(f"{path}: holds no splats that can be drawn; write it again with some")
    mean = np.stack([columns[name][good].astype(np.float64) for name in POSITION], axis=1)

    def stack(names: list[str]) -> npt.NDArray[np.float32]:
        return np.stack([single[name][good] for name in names], axis=1)

    log_scale, sh = stack(SCALE), stack([*DC, *rest])
    higher = sh[:, 3:].reshape(len(mean), 3, len(rest) // 3).transpose(0, 2, 1)
    middle, near = _placed(mean, log_scale)
    found = OrdinaryGaussians(
        (mean - middle).astype(np.float32),
        log_scale,
        stack(ROTATION),
        single["opacity"][good],
        np.ascontiguousarray(np.concatenate([sh[:, None, :3], higher], axis=1)),
        antialiased=bool(np.any(columns.get(ANTIALIASED, 0))),
    )
    world = from_text(list(comments))
    transform = SceneTransform(tuple(middle.tolist()), 1.0, *world)
    return SplatScene(found, RenderSettings(near=near), transform)


def _directions(columns: Columns) -> Columns:
    """The columns of the rotations; the largest component of extreme ones becomes 1."""
    quaternion = np.stack([columns[name].astype(np.float64) for name in ROTATION], axis=1)
    largest = np.abs(quaternion).max(axis=1)
    short, long = USUAL_LENGTHS
    extreme = (largest > 0) & (largest < short) | (largest > long) & np.isfinite(largest)
    quaternion[extreme] /= largest[extreme, None]
    return dict(zip(ROTATION, quaternion.T, strict=True))


def is_far(centre: npt.NDArray[np.float64], log_scale: npt.NDArray[np.float32]) -> bool:
    """Whether float32 is too coarse for splats around ``centre`` (3,) with scales (N, 3)."""
    largest = float(np.abs(centre).max())
    size = np.exp(min(float(np.median(log_scale.max(axis=1))), LOG_SCALE_LIMIT))
    return bool(largest * 2.0**-24 > FINE * size)


def _placed(
    mean: npt.NDArray[np.float64], log_scale: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.float64], float]:
    """The origin (3,) for positions (N, 3), 0 if that is fine enough, and the near plane.

    The near plane grows and shrinks with scenes that are much larger or smaller than usual.
    """
    middle = np.median(mean, axis=0)
    spread = float(np.median(np.linalg.norm(mean - middle, axis=1)))
    near = NEAR_PLANE * spread / float(np.clip(spread, *USUAL_SPREAD)) if spread else NEAR_PLANE
    return middle if is_far(middle, log_scale) else np.zeros(3), near
