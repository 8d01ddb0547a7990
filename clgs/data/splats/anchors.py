"""Anchors as the PLY files of Scaffold-GS and VOXEL-GS, and the MLPs next to them.

Properties stand in the order of NAMES and are float32, but for those of which float32 would not
give an integer back: they are float64. Offset j of an anchor on axis c is
``f_offset_{c * K + j}``. A file whose name has ".quantized" in it holds the integers, another one
the numbers that they stand for. What the reference does not keep at all (scales, transform, render
settings) is written as comments; opacity and rot are not used to render.

The MLPs are a NumPy archive with the reference's names of weights. The reference keeps them in
torch files, which are pickles and never read here.
"""

from __future__ import annotations

import io
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.arguments import plain_float
from clgs.codec.octree import MAX_EXTENT
from clgs.constants import FEATURE_DIM, HEAD_DIMS, K_OFFSETS
from clgs.data.splats.ply import PlyTable, narrowest, pack_ply, read_ply
from clgs.errors import DataError, OutputError, UsageError
from clgs.files import atomic_write_all, check_target
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.mlps import LAYERS, MLP_SIZE, Mlps, unpack_head
from clgs.scene.scene import MIN_Q, QuantizedScene, check_ranges
from clgs.scene.storage import DAMAGE, GROUPS, LATER, describe_damage, load_archive

TORCH_HEADS = {"opacity": "opacity_mlp", "color": "color_mlp", "covariance": "cov_mlp"}
TORCH_LAYERS = dict(zip(LAYERS, ("0.weight", "0.bias", "2.weight", "2.bias"), strict=True))
"""The reference's names of the weights: ``opacity_mlp.0.weight`` and so on."""

FIRST = f"{TORCH_HEADS['opacity']}.0.weight"


def mlps_path(path: Path) -> Path:
    """Where the MLPs of ``path`` lie: scene.ply and scene.quantized.ply have scene.mlps.npz."""
    stem = path.name
    for ending in (".ply", ".quantized"):
        if stem.lower().endswith(ending):
            stem = stem[: -len(ending)]
    return path.with_name(f"{stem}.mlps.npz")


def pack_mlps(mlps: Mlps) -> bytes:
    """The archive of ``mlps``, a pure function of them."""
    arrays: dict[str, Any] = {
        f"{TORCH_HEADS[head]}.{TORCH_LAYERS[layer]}": array
        for head in HEAD_DIMS
        for layer, array in mlps.head(head).items()
    }
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def load_mlps(path: Path) -> Mlps:
    """The weights in an archive: ``mlps`` (13710,), or the reference's names.

    Raises:
        DataError: missing, damaged, or another network.
    """
    try:
        with path.open("rb") as file, load_archive(file) as archive:
            flat = _flat_weights(archive)
    except FileNotFoundError:
        raise DataError(
            f"{path}: the PLY file has no MLPs and this file is missing; name one with --mlps: "
            f"arrays {FIRST} ... saved from the torch file by np.savez"
        ) from None
    except DAMAGE as error:
        raise DataError(
            f"{path}: not an archive of the MLPs ({describe_damage(error)}); save arrays {FIRST} "
            "... by np.savez"
        ) from None
    if not np.isfinite(flat).all():
        raise DataError(f"{path}: a weight is not finite; train the scene again")
    return Mlps(flat)


def holds(path: Path, mlps: Mlps) -> bool:
    """Whether ``path`` is an archive of the very weights of ``mlps``."""
    try:
        found = load_mlps(path)
    except DataError:
        return False
    return bool((found.flat.view(np.uint32) == mlps.flat.view(np.uint32)).all())


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


POSITION, NORMAL = ["x", "y", "z"], ["nx", "ny", "nz"]
OFFSET = [f"f_offset_{i}" for i in range(3 * K_OFFSETS)]
FEATURE = [f"f_anchor_feat_{i}" for i in range(FEATURE_DIM)]
SCALING = [f"scale_{i}" for i in range(6)]
ROTATION = [f"rot_{i}" for i in range(4)]
NAMES = [*POSITION, *NORMAL, *OFFSET, *FEATURE, "opacity", *SCALING, *ROTATION]

COMMENT = "clgs"

_Columns = dict[str, npt.NDArray[Any]]


def is_quantized(path: Path) -> bool:
    """Whether the name says that the file holds integers."""
    return ".quantized" in path.name.lower()


def save_scaffold(path: Path, scene: QuantizedScene, overwrite: bool = False) -> None:
    """Write the anchors to ``path`` and the MLPs to ``mlps_path(path)``, in scene units.

    Both are written or none. An archive that holds these MLPs already stays as it is; one that
    holds others is replaced with ``overwrite`` or together with ``path`` alone.

    Raises:
        OutputError: the file for the MLPs of ``path`` exists already, but ``path`` does not.
        OutputError, OSError: as of ``atomic_write_all``.
    """
    archive = mlps_path(path)
    check_target(archive)
    files = {path: pack_scaffold(scene, is_quantized(path))}
    if not (archive.exists() and holds(archive, scene.mlps)):
        if archive.exists() and not (path.exists() or overwrite):
            problem = "exists and holds other MLPs; remove it or choose another output"
            raise OutputError(f"{archive}: {problem}")
        files[archive] = pack_mlps(scene.mlps)
    atomic_write_all(files)


def pack_scaffold(scene: QuantizedScene, quantized: bool) -> bytes:
    """The PLY file of the anchors, as integers or as what they stand for."""
    anchors, scales, count = scene.anchors, scene.scales, len(scene.anchors)

    def columns(names: list[str], rows: npt.NDArray[np.int32], scale: float) -> _Columns:
        scale = 1.0 if quantized else scale
        return {
            name: narrowest(rows[:, i], lambda n: n / np.float64(scale), lambda v: v * scale)
            for i, name in enumerate(names)
        }

    zeros, offset = np.zeros(count, np.float32), anchors.offset.transpose(0, 2, 1)
    blocks = {
        **columns(POSITION, anchors.position, scales.position),
        **dict.fromkeys(NORMAL, zeros),
        **columns(OFFSET, offset.reshape(count, len(OFFSET)), scales.offset),
        **columns(FEATURE, anchors.feature, scales.feature),
        "opacity": zeros,
        **columns(SCALING, anchors.scaling, scales.scaling),
        **dict.fromkeys(ROTATION, zeros),
        ROTATION[0]: np.ones(count, np.float32),
    }
    comments = [  # numbers that round-trip
        f"{COMMENT} {group}.{name} {' '.join(repr(float(x)) for x in np.atleast_1d(value))}"
        for group in _GROUPS
        for name, value in asdict(getattr(scene, group)).items()
        if f"{group}.{name}" not in LATER or value != getattr(_GROUPS[group], name)
    ]
    return pack_ply(PlyTable(blocks, comments))


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
        UsageError: the file holds integers, and its comments say another Q than ``scales``.
    """
    table, quantized = read_ply(path), is_quantized(path)
    try:
        found, stated = _read_comments(table.comments)
        if scales and quantized and "scales" in stated and scales != found["scales"]:
            numbers = ",".join(f"{number:g}" for number in vars(found["scales"]).values())
            raise UsageError(f"{path}: its integers have Q {numbers}; leave out other ones (--q)")
        scales = scales or found["scales"]
        check_ranges(scales, found["transform"], found["settings"])
        anchors = _anchors(path, table, scales)
    except (ValueError, TypeError) as error:
        raise DataError(f"{path}: {error}; write the file again") from None
    weights = load_mlps(mlps or mlps_path(path))
    return QuantizedScene(anchors, weights, scales, found["settings"], found["transform"])


def _anchors(path: Path, table: PlyTable, scales: QuantizationScales) -> QuantizedAnchors:
    quantized = is_quantized(path)

    def integers(names: list[str], scale: float, letter: str) -> npt.NDArray[np.int32]:
        missing = [name for name in names if name not in table.columns]
        if missing:
            problem = f"{path}: property {missing[0]} is missing; this is no file of anchors"
            raise DataError(f"{problem} (`clgs pack` takes ordinary splats)")
        values = np.stack([table.columns[name].astype(np.float64) for name in names], 1)
        whole = np.rint(values if quantized else values * scale)
        bad = ~((whole >= -(2.0**31)) & (whole < 2.0**31))
        if bad.any():
            row, column = np.unravel_index(np.argmax(abs(values)), bad.shape)  # NaN before all
            value = float(values[row, column])
            place = f"{path}: {names[column]} of row {row} is {value:g}"
            span = float(np.ptp(values, axis=0).max()) if letter == "P" else 0.0
            raise DataError(f"{place}{_unfit(value, None if quantized else scale, letter, span)}")
        if quantized and not (whole == values).all():
            problem = f"{path}: the name says .quantized, but not all numbers are whole"
            raise DataError(f"{problem}; give it another name, or round them")
        return whole.astype(np.int32)

    offset = integers(OFFSET, scales.offset, "O").reshape(-1, 3, K_OFFSETS)
    return QuantizedAnchors(
        position=integers(POSITION, scales.position, "P"),
        offset=np.ascontiguousarray(offset.transpose(0, 2, 1)),
        feature=integers(FEATURE, scales.feature, "A"),
        scaling=integers(SCALING, scales.scaling, "S"),
    )


def _unfit(value: float, scale: float | None, letter: str, span: float) -> str:
    """Why ``value`` is not an int32 at Q ``scale`` (None: it is an integer), and the remedy."""
    if not np.isfinite(value):
        return "; correct it or leave the anchor out"
    if scale is None:
        return ", beyond int32; correct it or leave the anchor out"
    least = max(abs(value) / (2**31 - 1), span / (MAX_EXTENT - 2))
    problem, most = f", beyond int32 at Q {scale:g}", 0.9 / least  # it is shown with two digits
    if most < MIN_Q:
        return f"{problem} and any other; correct it or leave the anchor out"
    return f"{problem}; correct it, or give {letter} of --q P,O,A,S as {most:.2g} or less"


_GROUPS = {name: GROUPS[name] for name in ("scales", "transform", "settings")}


_FIELD = re.compile(rf"({'|'.join(_GROUPS)})\.\w+")


def _read_comments(comments: list[str]) -> tuple[dict[str, Any], set[str]]:
    """The groups, with defaults for fields that no line names, and the names of those with lines.

    Lines of other programs are passed over.

    Raises:
        ValueError: a line for a group makes no sense.
    """
    given: dict[str, list[float]] = {}
    for comment in comments:
        match comment.split():
            case [word, name, *text] if word == COMMENT and _FIELD.fullmatch(name):
                given[name] = [plain_float(number) for number in text]
    stated = {name.partition(".")[0] for name in given}
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
    return groups, stated
