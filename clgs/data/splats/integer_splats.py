"""Ordinary Gaussians of any file to integers in stated steps, and back to a PLY file.

Quaternions (rot_0 to rot_3) are scaled to length 1 with rot_0 >= 0 first: the same rotation, in
numbers that one step suits.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.codec.octree import MAX_EXTENT
from clgs.codec.splat_packing import MAX_STEP, QuantizedSplats, quantize
from clgs.data.splats.gaussians import (
    ANTIALIASED,
    FEATURE_OF_ANCHORS,
    MARK,
    POSITION,
    ROTATION,
    SCALE,
    read_splat_table,
)
from clgs.data.splats.ply import PlyTable, narrowest, pack_ply
from clgs.errors import ClgsError, DataError, UsageError
from clgs.scene.world import EARTH, from_text, in_words

STEPS = {
    "f_dc": 1 / 64,
    "f_rest": 1 / 32,
    "opacity": 1 / 32,
    "scale": 1 / 16,
    "rot": 1 / 256,
    "normal": 1 / 64,
}
"""Default steps by group: a color moves by half of 1 / 226, an opacity by at most 1 / 256, a size
by 3 %, a rotation by a quarter of a degree. The steps of ``position`` depend on the splats."""

GROUPS = dict.fromkeys(POSITION, "position") | dict.fromkeys(("nx", "ny", "nz"), "normal")

Columns = Mapping[str, npt.NDArray[np.float64]]
"""Finite numbers (N,) by name of the property."""

_log = logging.getLogger(__name__)


def read_splats(path: Path, steps: dict[str, float]) -> tuple[QuantizedSplats, dict[str, float]]:
    """The splats of a file, and the largest rounding error of each group.

    Splats that are meant for antialiased drawing get the property ANTIALIASED, 1 in each row.

    Args:
        path: PLY file with x, y, z and at least one more property, or an SPZ or SOG file.
        steps: by group or by name of a property, before the defaults.

    Raises:
        DataError: no such file, or a property that is needed is missing or not finite.
        UsageError: a property without a step, or a step for none.
    """
    table = read_splat_table(path)
    if (world := from_text(table.comments))[0] == EARTH:
        text = "%s: packed splats do not hold where their origin is: %s"
        _log.warning(text, path, in_words(*world))
    if MARK in table.comments:
        table.columns[ANTIALIASED] = np.ones(len(table), np.int32)
    if FEATURE_OF_ANCHORS in table.columns:
        raise DataError(f"{path}: holds anchors, no splats; `clgs encode` takes it")
    missing = [name for name in POSITION if name not in table.columns]
    if missing or len(table.columns) < 4:
        raise DataError(f"{path}: property {(missing or ['after z'])[0]} is missing; no splats")
    names = [*POSITION, *(name for name in table.columns if name not in POSITION)]
    with np.errstate(invalid="ignore"):  # NaNs are refused by name
        values = {name: table.columns[name].astype(np.float64) for name in names}
    for name in names:
        if not np.isfinite(values[name]).all():
            raise DataError(
                f"{path}: property {name}: a number is not finite; "
                "`clgs export FILE -o clean.ply` leaves such splats out"
            )
    if all(name in values for name in ROTATION):
        rotation = np.stack([values[name] for name in ROTATION], 1)
        length = np.linalg.norm(rotation, axis=1, keepdims=True)
        rotation /= np.where(length > 0, length, 1.0)
        rotation *= np.where(rotation[:, :1] < 0, -1.0, 1.0)
        values.update({name: rotation[:, i] for i, name in enumerate(ROTATION)})
    kinds = {name: column.dtype for name, column in table.columns.items()}
    try:
        chosen = choose_steps(values, kinds, steps)
        integers = [quantize(values[name], chosen[name], name) for name in names]
    except ClgsError as problem:
        raise type(problem)(f"{path}: {problem}") from None
    errors: dict[str, float] = {}
    for name, column in zip(names, integers, strict=True):
        error = float(np.abs(column * chosen[name] - values[name]).max(initial=0.0))
        errors[group_of(name)] = max(error, errors.get(group_of(name), 0.0))
    return QuantizedSplats(names, [chosen[name] for name in names], np.stack(integers, 1)), errors


def write_splats(splats: QuantizedSplats) -> bytes:
    """The PLY file of ``splats``: float32, or float64 if float32 would lose an integer."""

    def column(integers: npt.NDArray[np.int32], step: float) -> npt.NDArray[np.floating]:
        return narrowest(integers, lambda n: n * np.float64(step), lambda v: v / step)

    steps = zip(splats.names, splats.steps, strict=True)
    columns = {name: column(splats.values[:, i], step) for i, (name, step) in enumerate(steps)}
    antialiased = bool(np.any(columns.pop(ANTIALIASED, 0)))
    return pack_ply(PlyTable(columns, ["unpacked by clgs", *[MARK] * antialiased]))


def group_of(name: str) -> str:
    """The group of a property: "position", "normal", "f_rest" of "f_rest_7", or its own name."""
    return GROUPS.get(name) or (name.rstrip("0123456789").rstrip("_") or name)


def choose_steps(
    values: Columns, kinds: Mapping[str, np.dtype[np.generic]], named: dict[str, float]
) -> dict[str, float]:
    """The step of every property.

    Args:
        values: of all properties, those of POSITION among them.
        kinds: types that the file has for them; integers need no step.
        named: steps that the user names, by group or by property.

    Raises:
        UsageError: a property without a step, or a step for none.
        DataError: splats are too far apart for any step of positions.
    """
    known = {*values, *map(group_of, values)}
    if unknown := [name for name in named if name not in known]:
        raise UsageError(f"--step {unknown[0]}: the file has no such property or group")
    chosen, open_names = {}, []
    for name in values:
        group = group_of(name)
        step = named.get(name, named.get(group, STEPS.get(group)))
        if step is None and kinds[name].kind != "f":
            step = 1.0
        if step is not None:
            chosen[name] = step
        elif group != "position":
            open_names.append(name)
    if open_names:
        options = " ".join(f"--step {name}=STEP" for name in open_names)
        which = f"property {open_names[0]} has" if len(open_names) == 1 else "properties have"
        raise UsageError(f"{which} no default step; give {options}")
    open_axes = {name for name in POSITION if name not in chosen}
    if open_axes:
        steps = position_steps(values, {name: kinds[name] for name in POSITION}, open_axes)
        chosen.update(steps)
    return chosen


def position_steps(
    values: Columns, kinds: Mapping[str, np.dtype[np.generic]], axes: set[str]
) -> dict[str, float]:
    """The default steps of ``axes``, powers of two; warns if they are coarser than they should be.

    They should be the largest that is at most an eighth of the median scale, or without scales
    1 / 65536 of the extent (see ``usual_extent``); but if float32 is coarser on an axis, its
    resolution. They must let positions span less than 2^21 steps, and lie within 2^31 of them.
    """
    if not len(values["x"]):
        return dict.fromkeys(axes, 2.0**-16)
    if all(name in values for name in SCALE):
        size = np.exp(np.clip(np.median([values[name] for name in SCALE]), -30, 30)) / 8
    else:
        size = max(usual_extent(values[name]) for name in POSITION) / 65536
    wanted = float(2.0 ** np.clip(np.floor(np.log2(size)), -64, 64)) if size > 0 else 2.0**-16
    extents = {name: float(np.ptp(values[name])) for name in sorted(axes)}
    widest = max(extents, key=lambda name: extents[name])
    # One more for rounding at either end.
    cubic = _at_least(extents[widest] / (MAX_EXTENT - 2))
    steps, problems = {}, {}
    for name in extents:
        finest = max(wanted, resolution(values[name], kinds[name]))
        reach = float(np.abs(values[name]).max())
        held = _at_least(reach / (2.0**31 - 1))
        if max(cubic, held) > MAX_STEP:
            far = (
                f"{widest} spans {extents[widest]:g}"
                if cubic > held
                else f"{name} reaches {reach:g}"
            )
            raise DataError(f"{far}, more than any step holds; correct or crop distant splats")
        steps[name] = min(max(finest, cubic, held), MAX_STEP)
        if cubic > finest:
            spans = f"{widest} spans {extents[widest]:g}, 2^21 steps at most: crop distant splats"
            problems[steps[name]] = finest, spans
        elif held > finest:
            far = f"{name} reaches {reach:g}, 2^31 steps at most: move the splats to the origin"
            problems[steps[name]] = finest, far
    for step, (finest, problem) in problems.items():
        _log.warning(
            "the step of positions is %g in place of %g, because %s, or accept it by "
            "--step position=%g", step, finest, problem, step,
        )  # fmt: skip
    return steps


def usual_extent(column: npt.NDArray[np.float64]) -> float:
    """The extent of ``column`` (N,) without a few floaters: 4 times that of the middle 90 %.

    It is never more than the true extent, and equals it unless a few splats lie far from the rest.
    """
    low, high = np.percentile(column, [5, 95])
    true = float(np.ptp(column))
    return min(true, 4 * float(high - low)) or true


def resolution(column: npt.NDArray[np.float64], kind: np.dtype[np.generic]) -> float:
    r"""The spacing of numbers of type ``kind`` at the least 1 % of the sizes in ``column`` (N,)."""
    if kind != np.float32:
        return 0.0
    return float(np.spacing(np.float32(np.percentile(np.abs(column), 1))))


def _at_least(step: float) -> float:
    """The smallest power of two that is not below ``step``."""
    return float(2.0 ** np.ceil(np.log2(step))) if step > 0 else 0.0
