"""Scenes of ordinary Gaussians, from the files of 3DGS trainers and from what `clgs pack` made.

Splats are read as columns by the names of 3DGS's properties, from PLY files of 3DGS, Scaffold's
anchors included, PLY files of SuperSplat with chunks, SPZ, SOG, and the meta.json of a SOG that is
a folder. The first bytes of a file say which it is; a .splat file has only its name.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.arguments import as_path
from clgs.codec.splat_packing import QuantizedSplats, unpack
from clgs.constants import LOG_SCALE_LIMIT, NEAR_PLANE
from clgs.data.splats import ply, sog, splat, spz
from clgs.data.splats.ply import PlyTable, element_names, parse_ply, reading
from clgs.errors import CodecError, DataError
from clgs.scene.gaussians import DEGREES, MAX_DEGREE, SH_0, OrdinaryGaussians, logit, sigmoid
from clgs.scene.scene import RenderSettings, SceneTransform, SplatScene
from clgs.scene.world import from_text, to_text

DC = [f"f_dc_{i}" for i in range(3)]
POSITION = ["x", "y", "z"]
ROTATION = [f"rot_{i}" for i in range(4)]
SCALE = [f"scale_{i}" for i in range(3)]
REST = "f_rest_"
FEATURE_OF_ANCHORS = "f_anchor_feat_0"
"""A property that files of anchors have and files of splats do not."""

FILTER = "filter_3D"
"""Mip-Splatting's width of the 3-D filter, scene units; its scales are without the filter."""

ANTIALIASED = "antialiased"
"""A property of packed splats: 1 if their opacities are meant for antialiased drawing."""

MARK = "SplatRenderMode: mip"
"""The comment in a PLY file that says so, as Brush writes it and splat-transform reads it."""

OPAQUE = 20.0
"""A logit whose opacity is 1 in float32."""

MOST_UNIT = 2.0
"""Colors in floats go to 1, or a little beyond; if one is larger than this, they go to 255."""

MOST_REST = 3 * ((MAX_DEGREE + 1) ** 2 - 1)

_RENDER_MODE = r"(?:render|raster(?:i[sz](?:er?|ation))?)[\s_-]?mode"
_NAME = r"(?:anti[\s_-]?alias(?:ed|ing)?|mip[\s_-]?splat(?:s|ting)?)"
_SAYS = r"(?:\s*[:=]\s*|\s+(?:(?:is|was)\s+)?)"
_MODES = {"mip": True, "antialiased": True} | dict.fromkeys(
    ("default", "classic", "standard", "normal", "none", "2dgs", "3dgs"), False
)
_VALUES = dict.fromkeys(("1", "1.0", "true", "yes", "on", "enabled"), True) | dict.fromkeys(
    ("0", "0.0", "false", "no", "off", "disabled", "none", "null"), False
)


def _said(key: str, values: Iterable[str]) -> str:
    words = "|".join(map(re.escape, sorted(values, key=len, reverse=True)))
    return rf"(?<![\w-])(?:--)?{key}{_SAYS}({words})(?!\w|[.-]\w)"


_MARKS = re.compile(
    _said(rf"(?:splat[\s_-]?)?{_RENDER_MODE}", _MODES) + "|" + _said(_NAME, _VALUES), re.ASCII
)
_ALONE = re.compile(rf"(?:[\w.]+[.]|--)?{_NAME}|.*?\s--{_NAME}(?:\s+-.*)?", re.ASCII)
_SUBJECT = re.compile(rf"{_NAME}|{_RENDER_MODE}\s*[:=]", re.ASCII)
_CLAUSES = re.compile(r"[;,{}]")
_log = logging.getLogger(__name__)

Columns = dict[str, npt.NDArray[Any]]


def read_splat_table(path: Path) -> PlyTable:
    """The splats of a file; comments are MARK, if they must be drawn antialiased, and their world.

    Infinite opacities and infinitely thin splats become finite, colors of 8 bits become f_dc,
    2-D splats get a third scale, a filter is made part of the splats, and coefficients of a degree
    above 3 are left out with a line in the log.

    Raises:
        DataError: no such file, or it is damaged.
    """
    with reading(path), np.errstate(over="ignore", invalid="ignore"):  # scene_of looks
        data = path.read_bytes()
        if not data:
            raise ValueError("the file is empty")
        if path.suffix.lower() == splat.SUFFIX:
            table = splat.decode_splat(data)
        elif data[:2] == spz.GZIP or data[:4] == spz.MAGIC:
            table = spz.decode_spz(data)
        elif data[:4] == sog.ZIP:
            table = sog.decode_sog(data)
        elif data.lstrip()[:1] == b"{":
            table = sog.decode_sog(data, path.parent)
        elif "chunk" in element_names(data):
            table = ply.decode_chunks(data)
        else:
            table = parse_ply(data)
        columns = dict(table.columns)
        marked = is_antialiased(table.comments)
        antialiased = bool(marked or np.any(columns.pop(ANTIALIASED, 0)))
        if "opacity" in columns and FEATURE_OF_ANCHORS not in columns:
            antialiased |= _as_3dgs(columns, path)
        unclear = [c for c in table.comments if _SUBJECT.search(c.lower())]
        if unclear and marked is None and not antialiased:
            text = "%s: comment %r: unclear whether splats are antialiased; drawn as if not"
            _log.warning(f"{text}; 'comment antialiased 1' or 0 says so", path, unclear[0][:80])
    world = [text] if (text := to_text(*from_text(table.comments))) else []
    return PlyTable(columns, [MARK] * antialiased + world)


def is_antialiased(comments: list[str]) -> bool | None:
    """Whether comments of a PLY file say that the splats were trained with antialiasing.

    Brush, gsplat and splat-transform write a mode, Postshot and others a switch, Mip-Splatting's
    users its name; the last counts. A comment may hold several of them, and other words. None: no
    comment speaks of it, or only in words that may mean either.
    """
    found = None
    for clause in _CLAUSES.split(";".join(comments)):
        words = clause.replace('"', "").replace("'", "").strip().lower()
        if _ALONE.fullmatch(words):
            found = True
        for mode, switch in _MARKS.findall(words):
            found = _MODES[mode] if mode else _VALUES[switch]
    return found


def _as_3dgs(columns: Columns, path: Path) -> bool:
    """Change ``columns`` to what 3DGS means by them; whether they must be drawn antialiased."""
    if "scale_0" in columns and "scale_1" in columns and "scale_2" not in columns:
        columns["scale_2"] = np.full_like(columns["scale_1"], -LOG_SCALE_LIMIT)
    opacity = columns["opacity"]
    columns["opacity"] = np.where(opacity == np.inf, opacity.dtype.type(OPAQUE), opacity)
    for name in SCALE:
        if name in columns:
            size = columns[name]
            thin = size.dtype.type(-LOG_SCALE_LIMIT)
            columns[name] = np.where(size == -np.inf, thin, size)
    primaries = [name for name in ("red", "green", "blue") if name in columns]
    if len(primaries) == 3 and not any(name in columns for name in DC):
        colors = [columns.pop(primary) for primary in primaries]
        bytes_as_floats = max(float(color.max(initial=0)) for color in colors) > MOST_UNIT
        for name, color in zip(DC, colors, strict=True):
            white = np.iinfo(color.dtype).max if color.dtype.kind in "iu" else 1.0
            white = 255.0 if color.dtype.kind == "f" and bytes_as_floats else float(white)
            columns[name] = ((color / white - 0.5) / SH_0).astype(np.float32)
    _cut_degree(columns, path)
    if FILTER not in columns or any(name not in columns for name in SCALE):
        return False
    _apply_filter(columns)
    return True


def _cut_degree(columns: Columns, path: Path) -> None:
    """Leave out the coefficients of degrees that are not drawn, 4 and more."""
    count = sum(name.startswith(REST) for name in columns)
    degree = int(np.sqrt(1 + count // 3)) - 1
    rest = [f"{REST}{i}" for i in range(count)]
    if (
        degree <= MAX_DEGREE
        or count != 3 * ((degree + 1) ** 2 - 1)
        or not columns.keys() >= {*rest}
    ):
        return
    text = "%s: colors of degree %d are cut to %d; the rest is not drawn"
    _log.warning(text, path, degree, MAX_DEGREE)
    kept, every = MOST_REST // 3, count // 3
    values = [columns.pop(name) for name in rest]
    for channel in range(3):
        for i in range(kept):
            columns[f"{REST}{kept * channel + i}"] = values[every * channel + i]


def _apply_filter(columns: Columns) -> None:
    """Make Mip-Splatting's 3-D filter part of scales and opacities (Yu et al. 2024, section 4.1).

    Variances grow by the filter's, and opacities shrink as the volume grows: that of a flat splat
    by its area, because any thickness would be infinitely many times its own.
    """
    variance = columns.pop(FILTER).astype(np.float64) ** 2
    limit = LOG_SCALE_LIMIT
    shrunk = np.zeros(len(variance))
    for name in SCALE:
        before = np.clip(columns[name].astype(np.float64), -limit, limit)
        after = 0.5 * np.log(np.exp(2 * before) + variance)
        shrunk += np.where(before > -limit, before - after, 0.0)
        columns[name] = after.astype(columns[name].dtype)
    opacity = sigmoid(columns["opacity"]) * np.exp(shrunk)
    columns["opacity"] = logit(opacity).astype(columns["opacity"].dtype)


FINE = 2.0**-10
"""Positions in float32 must be this many times finer than half of the splats are large."""

USUAL_SPREAD = 2.0, 40.0
"""Scenes that spread like this, in their own units, are drawn from the usual near plane on."""

USUAL_LENGTHS = 1e-30, 1e30
"""Quaternions of these lengths are made unit ones where they are drawn, in float32."""

Properties = Mapping[str, npt.NDArray[Any]]


def load_splats(path: Path | str) -> SplatScene:
    """Ordinary Gaussians to render: a .ply, .spz, .sog or .splat file, or one of ``clgs pack``.

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


def problem_of(names: Collection[str]) -> str:
    """Why properties with these names are none of 3DGS splats; empty if they are."""
    rest = [f"{REST}{i}" for i in range(sum(name.startswith(REST) for name in names))]
    needed = *POSITION, *DC, "opacity", *SCALE, *ROTATION
    if missing := [name for name in needed if name not in names]:
        return f"property {missing[0]} is missing, so these are points, no 3DGS splats"
    if missing := [name for name in rest if name not in names]:
        return f"property {missing[0]} is missing; {REST}* count from 0 without a gap"
    whole = len(rest) % 3 == 0 and 1 + len(rest) // 3 in DEGREES
    return "" if whole else f"{len(rest)} properties {REST}*; 0, 9, 24 or 45 make a whole degree"


def scene_of(columns: Properties, path: Path, comments: Sequence[str] = ()) -> SplatScene:
    """The scene of columns (N,) by name of the property; ``path`` is named in errors.

    ``comments``: one of them may say what the world is.

    Raises:
        DataError: a property is missing, or there are no splats.
    """
    if FEATURE_OF_ANCHORS in columns:
        raise DataError(
            f"{path}: holds anchors, no splats; `clgs encode` makes a .clgs file of it first"
        )
    if problem := problem_of(columns):
        raise DataError(f"{path}: {problem}")
    rest = [f"{REST}{i}" for i in range(sum(name.startswith(REST) for name in columns))]
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


def _directions(columns: Properties) -> Properties:
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
