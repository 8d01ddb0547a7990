"""Anchors as the PLY files of Scaffold-GS and VOXEL-GS, and the MLPs beside them as NumPy archive.

All properties are float32, in the order of NAMES; offset j of an anchor on axis c is
``f_offset_{c * K + j}``. A file whose name has ".quantized" in it holds the integers, another one
the numbers that they stand for. The reference keeps the MLPs in torch files, which are pickles
and never read here. What the reference does not keep at all (scales, transform, render settings)
is written as comments; opacity and rot are of no use to a render.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, HEAD_DIMS, K_OFFSETS
from clgs.data.ply import Table, pack_ply, read_ply
from clgs.errors import DataError
from clgs.files import atomic_write
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors, dequantize
from clgs.scene.mlps import LAYERS, MLP_SIZE, Mlps, unpack_head
from clgs.scene.ranges import check_ranges
from clgs.scene.scene import QuantizedScene, RenderSettings, SceneTransform
from clgs.scene.storage import DAMAGE

POSITION, NORMAL = ["x", "y", "z"], ["nx", "ny", "nz"]
OFFSET = [f"f_offset_{i}" for i in range(3 * K_OFFSETS)]
FEATURE = [f"f_anchor_feat_{i}" for i in range(FEATURE_DIM)]
SCALING = [f"scale_{i}" for i in range(6)]
ROTATION = [f"rot_{i}" for i in range(4)]
NAMES = [*POSITION, *NORMAL, *OFFSET, *FEATURE, "opacity", *SCALING, *ROTATION]

COMMENT = "clgs"
LIMIT = float(2**24)
"""Integers below it are exact in float32."""

TORCH_HEADS = {"opacity": "opacity_mlp", "color": "color_mlp", "covariance": "cov_mlp"}
TORCH_LAYERS = dict(zip(LAYERS, ("0.weight", "0.bias", "2.weight", "2.bias"), strict=True))
"""The reference's names of the weights: ``opacity_mlp.0.weight`` and so on."""


def is_quantized(path: Path) -> bool:
    """Whether the name says that the file holds integers."""
    return ".quantized" in path.name


def mlps_path(path: Path) -> Path:
    """Where the MLPs of ``path`` lie: scene.ply and scene.quantized.ply have scene.mlps.npz."""
    stem = path.name.removesuffix(".ply").removesuffix(".quantized")
    return path.with_name(f"{stem}.mlps.npz")


def save_scaffold(path: Path, scene: QuantizedScene) -> None:
    """Write the anchors to ``path`` and the MLPs to ``mlps_path(path)``, in scene units.

    Raises:
        DataError: an integer is too large for float32.
    """
    anchors = scene.anchors
    largest = max(np.abs(a).max(initial=0) for a in asdict(anchors).values())
    if largest >= LIMIT:
        raise DataError(f"{path}: {largest} is not exact in float32; decode to .npz")
    values = anchors if is_quantized(path) else dequantize(anchors, scene.scales)
    count = len(anchors)
    blocks = {
        **_columns(POSITION, values.position),
        **_columns(NORMAL, np.zeros((count, 3))),
        **_columns(OFFSET, values.offset.transpose(0, 2, 1).reshape(count, len(OFFSET))),
        **_columns(FEATURE, values.feature),
        "opacity": np.zeros(count, np.float32),
        **_columns(SCALING, values.scaling),
        **_columns(ROTATION, np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))),
    }
    atomic_write(path, pack_ply(Table(blocks, _comments(scene))))
    with_names = {
        f"{TORCH_HEADS[head]}.{TORCH_LAYERS[layer]}": array
        for head in HEAD_DIMS
        for layer, array in scene.mlps.head(head).items()
    }
    _save_npz(mlps_path(path), with_names)


def load_scaffold(
    path: Path, mlps: Path | None = None, scales: QuantizationScales | None = None
) -> QuantizedScene:
    """The scene of a PLY file.

    Args:
        path: PLY file.
        mlps: archive of the weights; default: ``mlps_path(path)``.
        scales: Q of the integers; default: those in the comments, else the method's own.

    Raises:
        DataError: a file is missing or damaged, or lacks a property or array.
    """
    table = read_ply(path)
    try:
        found = _read_comments(table.comments)
        scales = scales or found["scales"]
        check_ranges(scales, found["transform"], found["settings"])
        anchors = _anchors(table, scales, is_quantized(path))
    except (ValueError, TypeError) as error:
        raise DataError(f"{path}: {error}; write the file again") from None
    weights = _load_mlps(mlps or mlps_path(path))
    return QuantizedScene(anchors, weights, scales, found["settings"], found["transform"])


def _anchors(table: Table, scales: QuantizationScales, quantized: bool) -> QuantizedAnchors:
    def integers(names: list[str], scale: float) -> npt.NDArray[np.int32]:
        missing = [name for name in names if name not in table.columns]
        if missing:
            raise ValueError(f"property {missing[0]} is missing; this is no file of anchors")
        values = np.stack([table.columns[name].astype(np.float64) for name in names], 1)
        whole = np.rint(values if quantized else values * scale)
        bad = ~(np.abs(whole) < 2.0**31)
        if bad.any():
            row, column = np.argwhere(bad)[0]
            raise ValueError(f"{names[column]} of row {row} is {values[row, column]}")
        if quantized and not (whole == values).all():
            raise ValueError("the name says .quantized, but not all numbers are whole")
        return whole.astype(np.int32)

    offset = integers(OFFSET, scales.offset).reshape(-1, 3, K_OFFSETS)
    return QuantizedAnchors(
        position=integers(POSITION, scales.position),
        offset=np.ascontiguousarray(offset.transpose(0, 2, 1)),
        feature=integers(FEATURE, scales.feature),
        scaling=integers(SCALING, scales.scaling),
    )


def _columns(names: list[str], values: npt.NDArray[Any]) -> dict[str, npt.NDArray[np.float32]]:
    return {name: values[:, i].astype(np.float32) for i, name in enumerate(names)}


_GROUPS: dict[str, Any] = {
    "scales": QuantizationScales(),
    "transform": SceneTransform(),
    "settings": RenderSettings(),
}


def _comments(scene: QuantizedScene) -> list[str]:
    """One line a field: the word clgs, group.field, numbers that round-trip."""
    return [
        f"{COMMENT} {group}.{name} {' '.join(repr(float(x)) for x in np.atleast_1d(value))}"
        for group in _GROUPS
        for name, value in asdict(getattr(scene, group)).items()
    ]


def _read_comments(comments: list[str]) -> dict[str, Any]:
    """The groups, defaults where no line names a field; ValueError where a line makes no sense."""
    given: dict[str, list[float]] = {}
    for comment in comments:
        word, *rest = comment.split() or [""]
        if word == COMMENT and rest:
            given[rest[0]] = [float(number) for number in rest[1:]]
    groups = {}
    for group, default in _GROUPS.items():
        values = asdict(default)
        for name, value in values.items():
            numbers = given.pop(f"{group}.{name}", None)
            if numbers is not None:
                if len(numbers) != np.size(value):
                    raise ValueError(f"comment {group}.{name} has {len(numbers)} numbers")
                values[name] = tuple(numbers) if np.ndim(value) else numbers[0]
        groups[group] = type(default)(**values)
    if given:
        raise ValueError(f"comment {next(iter(given))} is not known")
    return groups


def _save_npz(path: Path, arrays: dict[str, npt.NDArray[Any]]) -> None:
    import io

    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]  # names of arrays, not of its arguments
    atomic_write(path, buffer.getvalue())


def _load_mlps(path: Path) -> Mlps:
    """The weights in an archive: ``mlps`` (13710,), or the reference's names.

    Raises:
        DataError: missing, damaged, or another network.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            flat = _flat_weights(archive)
    except FileNotFoundError:
        raise DataError(
            f"{path}: the PLY file has no MLPs and this file is missing; name one with --mlps: "
            f"arrays {TORCH_HEADS['opacity']}.0.weight ... saved from the torch file by np.savez"
        ) from None
    except DAMAGE as error:
        raise DataError(f"{path}: not an archive of the MLPs ({error}); write it again") from None
    if not np.isfinite(flat).all():
        raise DataError(f"{path}: a weight is not finite; train the scene again")
    return Mlps(flat)


def _flat_weights(archive: Any) -> npt.NDArray[np.float32]:
    flat = np.empty(MLP_SIZE, np.float32)
    if "mlps" in archive.files:
        flat[...] = archive["mlps"]
        return flat
    for head in HEAD_DIMS:
        for layer, target in unpack_head(flat, head).items():
            name = f"{TORCH_HEADS[head]}.{TORCH_LAYERS[layer]}"
            array = archive[name]
            if array.shape != target.shape:
                raise ValueError(f"{name} has shape {array.shape}, {target.shape} is needed")
            target[...] = array
    return flat
