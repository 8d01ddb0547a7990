"""Ordinary 3DGS PLY files to integers in stated steps, and back to float32.

Quaternions (rot_0 to rot_3) are scaled to length 1 with rot_0 >= 0 first: the same rotation, in
numbers that one step suits.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.codec.splats import Splats, position_step, quantize
from clgs.data.ply import Table, pack_ply, read_ply
from clgs.errors import DataError, UsageError

POSITION = ["x", "y", "z"]
ROTATION = [f"rot_{i}" for i in range(4)]
SCALE = [f"scale_{i}" for i in range(3)]

STEPS = {
    "f_dc": 1 / 64,
    "f_rest": 1 / 32,
    "opacity": 1 / 32,
    "scale": 1 / 16,
    "rot": 1 / 256,
    "normal": 1 / 64,
}
"""Default steps by group: a color moves by half of 1 / 226, an opacity by at most 1 / 256, a size
by 3 %, a rotation by a quarter of a degree. The step of ``position`` depends on the splats."""

GROUPS = {"x": "position", "y": "position", "z": "position"} | dict.fromkeys(
    ("nx", "ny", "nz"), "normal"
)


def group_of(name: str) -> str:
    """The group of a property: "position", "normal", "f_rest" of "f_rest_7", or its own name."""
    return GROUPS.get(name) or (name.rstrip("0123456789").rstrip("_") or name)


def read_splats(path: Path, steps: dict[str, float]) -> tuple[Splats, dict[str, float]]:
    """The splats of a PLY file, and the largest rounding error of each group.

    Args:
        path: PLY file with x, y, z and at least one more property.
        steps: by group or by name of a property, before the defaults.

    Raises:
        DataError: no such file, or a property that is needed is missing or not finite.
        UsageError: a property without a step, or a step for none.
    """
    table = read_ply(path)
    missing = [name for name in POSITION if name not in table.columns]
    if missing or len(table.columns) < 4:
        raise DataError(f"{path}: property {(missing or ['after z'])[0]} is missing; no splats")
    names = [*POSITION, *(name for name in table.columns if name not in POSITION)]
    values = {name: table.columns[name].astype(np.float64) for name in names}
    for name in names:
        if not np.isfinite(values[name]).all():
            raise DataError(f"{path}: property {name}: a number is not finite; correct the file")
    if all(name in values for name in ROTATION):
        _normalise(values)
    chosen = _choose(table, values, steps)
    integers = [quantize(values[name], chosen[name], name) for name in names]
    errors: dict[str, float] = {}
    for name, column in zip(names, integers, strict=True):
        error = float(np.abs(column * chosen[name] - values[name]).max(initial=0.0))
        errors[group_of(name)] = max(error, errors.get(group_of(name), 0.0))
    return Splats(names, [chosen[name] for name in names], np.stack(integers, 1)), errors


def write_splats(splats: Splats) -> bytes:
    """The PLY file of ``splats``, all float32."""
    columns = {
        name: (splats.values[:, i] * step).astype(np.float32)
        for i, (name, step) in enumerate(zip(splats.names, splats.steps, strict=True))
    }
    return pack_ply(Table(columns, ["unpacked by clgs"]))


def _normalise(values: dict[str, npt.NDArray[np.float64]]) -> None:
    rotation = np.stack([values[name] for name in ROTATION], 1)
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    rotation /= np.where(length > 0, length, 1.0)
    rotation *= np.where(rotation[:, :1] < 0, -1.0, 1.0)
    values.update({name: rotation[:, i] for i, name in enumerate(ROTATION)})


def _choose(
    table: Table, values: dict[str, npt.NDArray[np.float64]], steps: dict[str, float]
) -> dict[str, float]:
    """The step of every property."""
    known = {*values, *map(group_of, values)}
    if unknown := [name for name in steps if name not in known]:
        raise UsageError(f"--step {unknown[0]}: the file has no such property or group")
    chosen = {}
    for name in values:
        group = group_of(name)
        step = steps.get(name, steps.get(group, STEPS.get(group)))
        if step is None and group == "position":
            step = _position_step(values)
        elif step is None and table.columns[name].dtype.kind != "f":
            step = 1.0
        if step is None:
            raise UsageError(f"property {name} has no default step; give --step {name}=STEP")
        chosen[name] = step
    return chosen


def _position_step(values: dict[str, npt.NDArray[np.float64]]) -> float:
    if not len(values["x"]):
        return position_step(0.0, None)
    extent = max(float(np.ptp(values[name])) for name in POSITION)
    size = None
    if all(name in values for name in SCALE):
        size = float(np.exp(np.clip(np.median([values[name] for name in SCALE]), -30, 30)))
    return position_step(extent, size)
