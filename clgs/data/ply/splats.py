"""Ordinary 3DGS PLY files to integers in stated steps, and back.

Quaternions (rot_0 to rot_3) are scaled to length 1 with rot_0 >= 0 first: the same rotation, in
numbers that one step suits.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.codec.splat_packing import QuantizedSplats, quantize
from clgs.data.ply.splat_steps import POSITION, choose_steps, group_of
from clgs.data.ply.table import Table, narrowest, pack_ply, read_ply
from clgs.errors import ClgsError, DataError

FEATURE_OF_ANCHORS = "f_anchor_feat_0"
"""A property that files of anchors have, and files of splats have not."""

ROTATION = [f"rot_{i}" for i in range(4)]


def read_splats(path: Path, steps: dict[str, float]) -> tuple[QuantizedSplats, dict[str, float]]:
    """The splats of a PLY file, and the largest rounding error of each group.

    Args:
        path: PLY file with x, y, z and at least one more property.
        steps: by group or by name of a property, before the defaults.

    Raises:
        DataError: no such file, or a property that is needed is missing or not finite.
        UsageError: a property without a step, or a step for none.
    """
    table = read_ply(path)
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
            raise DataError(f"{path}: property {name}: a number is not finite; correct the file")
    if all(name in values for name in ROTATION):
        _normalise(values)
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
    steps = zip(splats.names, splats.steps, strict=True)
    columns = {name: _column(splats.values[:, i], step) for i, (name, step) in enumerate(steps)}
    return pack_ply(Table(columns, ["unpacked by clgs"]))


def _column(
    integers: npt.NDArray[np.int32], step: float
) -> npt.NDArray[np.float32] | npt.NDArray[np.float64]:
    return narrowest(integers, lambda n: n * np.float64(step), lambda v: v / step)


def _normalise(values: dict[str, npt.NDArray[np.float64]]) -> None:
    rotation = np.stack([values[name] for name in ROTATION], 1)
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    rotation /= np.where(length > 0, length, 1.0)
    rotation *= np.where(rotation[:, :1] < 0, -1.0, 1.0)
    values.update({name: rotation[:, i] for i, name in enumerate(ROTATION)})
