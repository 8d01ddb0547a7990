"""The splats of any file that is read, as columns by the names of 3DGS's properties.

PLY files of 3DGS, Scaffold's anchors included, PLY files of SuperSplat with chunks, SPZ, SOG, and
the meta.json of a SOG that is a folder. The first bytes of a file say which it is.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import LOG_SCALE_LIMIT
from clgs.data.splats import compressed_ply, sog, spz
from clgs.data.splats.numbers import SH_0, logit, sigmoid
from clgs.data.splats.table import PlyTable, element_names, parse_ply, reading
from clgs.scene.gaussians import MAX_DEGREE
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
        if data[:2] == spz.GZIP or data[:4] == spz.MAGIC:
            table = spz.decode_spz(data)
        elif data[:4] == sog.ZIP:
            table = sog.decode_sog(data)
        elif data.lstrip()[:1] == b"{":
            table = sog.decode_sog(data, path.parent)
        elif "chunk" in element_names(data):
            table = compressed_ply.decode_chunks(data)
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
