"""Ordinary Gaussian splats (3DGS) in a .clgs file: every property in steps of its own.

Lossless with respect to the steps. Rows come back in Morton order of their positions, splats of
one voxel in the order in which they were given (codec_c/FORMAT.md on splats).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec import streams
from clgs.codec.octree import MAX_EXTENT, PositionsError, morton_codes
from clgs.codec.reader import guarded
from clgs.codec.sections import (
    SATR,
    SMUL,
    SPLT,
    SPOS,
    Section,
    read_container,
    write_container,
)
from clgs.errors import CodecError

Ints = npt.NDArray[np.int32]

MIN_STEP, MAX_STEP = 2.0**-64, 2.0**64
MAX_PROPERTIES = streams.MAX_CHANNELS + 3
_HEAD = struct.Struct("<IIHHQ")
_PROPERTY = struct.Struct("<dB")


@dataclass(frozen=True)
class QuantizedSplats:
    """QuantizedSplats as integers; a value is integer * step.

    names: of the properties, the first three those of the position; steps: one per property,
    positive; values (N, properties) int32.
    """

    names: list[str]
    steps: list[float]
    values: Ints

    def __len__(self) -> int:
        return len(self.values)

    def check(self) -> None:
        """Raise ValueError if no file may hold these names, steps or values."""
        if not 4 <= len(self.names) <= MAX_PROPERTIES:
            raise ValueError(f"{len(self.names)} properties, 4 to {MAX_PROPERTIES} are possible")
        if len(set(self.names)) < len(self.names):
            raise ValueError("a property is named twice")
        for name, step in zip(self.names, self.steps, strict=True):
            if not (
                name.isascii() and name.isprintable() and 0 < len(name) < 256 and " " not in name
            ):
                raise ValueError(f"property {name[:60]!r}: a name is 1 to 255 letters")
            if not MIN_STEP <= step <= MAX_STEP:
                raise ValueError(f"property {name}: the step is {step!r}")
        if self.values.ndim != 2 or self.values.shape[1] != len(self.names):
            raise ValueError(f"shape is {self.values.shape}, (N, {len(self.names)}) is needed")
        if self.values.dtype != np.int32:
            raise ValueError(f"dtype is {self.values.dtype}, int32 is needed")


def pack(splats: QuantizedSplats, level: str = "default", threads: int | None = None) -> bytes:
    """The .clgs file of ``splats``; ``level`` and ``threads`` as of ``encode``.

    Raises:
        CodecError: positions span 2^21 voxels or more, or no file may hold the properties.
    """
    try:
        splats.check()
    except ValueError as error:
        raise CodecError(f"splats: {error}; correct them") from error
    for name, column in zip(splats.names[:3], splats.values.T, strict=False):
        cells = int(column.max()) - int(column.min()) + 1 if len(splats) else 0
        if cells > MAX_EXTENT:
            problem = f"splats: {name} spans {cells} steps, at most {MAX_EXTENT} fit"
            raise PositionsError(problem, "crop distant ones, or take a larger step", wide=True)
    values = sort_splats(splats.values)
    first = np.ones(len(values), bool)  # whether a row is the first of its voxel
    first[1:] = (values[1:, :3] != values[:-1, :3]).any(axis=1)
    count = np.diff(np.append(np.flatnonzero(first), len(values)))
    head = _HEAD.pack(len(values), len(count), len(splats.names), 0, _hash(values))
    for name, step in zip(splats.names, splats.steps, strict=True):
        head += _PROPERTY.pack(step, len(name)) + name.encode("ascii")
    sections = {
        SPLT: head,
        SPOS: streams.encode_positions(values[first, :3], threads),
        SMUL: streams.encode_attributes(count[:, None] - 1, "default", threads),
        SATR: streams.encode_attributes(values[:, 3:], level, threads),
    }
    return write_container(sections)


def unpack(data: bytes, threads: int | None = None) -> QuantizedSplats:
    """The splats that ``pack`` was given, in Morton order.

    Raises:
        CodecError: no file of splats, or damaged.
    """
    _, sections = read_container(data, splats=True)
    splats, voxels, content = guarded(sections[SPLT], _unpack_head)
    expected = {SPOS: (voxels, 3), SMUL: (voxels, 1), SATR: (len(splats), len(splats.names) - 3)}
    for tag, shape in expected.items():
        if streams.declared_shape(sections[tag].data) != shape:
            raise sections[tag].error(f"not the {shape[0]} rows of {shape[1]} that {SPLT} declares")
    position = _decode(sections[SPOS], streams.decode_positions, threads)
    count = _decode(sections[SMUL], streams.decode_attributes, threads)
    if (count < 0).any() or count.sum(dtype=np.int64) + voxels != len(splats):
        raise sections[SMUL].error("the voxels do not hold all splats")
    rows = _decode(sections[SATR], streams.decode_attributes, threads)
    values = np.concatenate([np.repeat(position, count[:, 0] + 1, axis=0), rows], axis=1)
    if _hash(values) != content:
        raise sections[SPLT].error("the decoded integers do not match their hash")
    return QuantizedSplats(splats.names, splats.steps, values)


def is_splats(data: bytes) -> bool:
    """Whether a .clgs file that begins like this holds splats."""
    return data[16:20] == SPLT.encode("ascii")


def describe(data: bytes) -> dict[str, object]:
    """Header and sizes of a file of splats, ready for JSON; of the payloads, positions are decoded.

    extent: the corners of the box of all means, in the file's units.

    Raises:
        CodecError: as ``unpack``, but for damage that only decoding can show.
    """
    _, sections = read_container(data, splats=True)
    splats, voxels, content = guarded(sections[SPLT], _unpack_head)
    sizes = {tag: len(section.data) for tag, section in sections.items()}
    extent = {}
    if voxels:
        if streams.declared_shape(sections[SPOS].data) != (voxels, 3):
            raise sections[SPOS].error(f"not the {voxels} voxels that {SPLT} declares")
        position = _decode(sections[SPOS], streams.decode_positions, None)
        corners = np.stack([position.min(axis=0), position.max(axis=0)]) * splats.steps[:3]
        extent = {"extent": dict(zip(("least", "greatest"), corners.tolist(), strict=True))}
    return {
        "bytes": len(data),
        "splats": len(splats),
        **extent,
        "voxels": voxels,
        "steps": dict(zip(splats.names, splats.steps, strict=True)),
        "content_hash": f"{content:016x}",
        "sections": {"container": len(data) - sum(sizes.values()), **sizes},
    }


def sort_splats(values: Ints) -> Ints:
    """Rows in Morton order of their first three columns, ties as they came."""
    return values[np.argsort(morton_codes(values[:, :3]), kind="stable")]


def quantize(values: npt.NDArray[np.floating], step: float, name: str) -> Ints:
    """Integers (N,) nearest to ``values`` / ``step``.

    Raises:
        CodecError: a value is not finite, or the step is too small for int32.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        whole = np.rint(values.astype(np.float64) / step)
        fit = (whole >= -(2.0**31)) & (whole < 2.0**31)
    if not fit.all():
        row = int(np.argmax(abs(values)))  # NaN before all
        value = float(values[row])
        place = f"property {name}: {value:g} in row {row}"
        if not np.isfinite(value):
            raise CodecError(f"{place} is not finite; correct it")
        raise CodecError(f"{place} is beyond int32 in steps of {step:g}; {_larger(name, values)}")
    return whole.astype(np.int32)


def _larger(name: str, values: npt.NDArray[np.floating]) -> str:
    """The remedy if a step is too small for finite ``values``."""
    least = float(abs(values).max()) / (2**31 - 1)
    if name in ("x", "y", "z"):
        least = max(least, float(np.ptp(values)) / (MAX_EXTENT - 2))
    least *= 1.1  # as it is shown with two digits
    if least > MAX_STEP:
        return "no step holds it; correct it or leave the splat out"
    return f"a --step {name}=STEP of {least:.2g} or more holds it"


def _decode(
    section: Section, function: Callable[[memoryview, int | None], Ints], threads: int | None
) -> Ints:
    try:
        return function(section.data, threads)
    except CodecError as error:
        raise section.error(str(error).partition(";")[0]) from error


def _unpack_head(data: memoryview) -> tuple[QuantizedSplats, int, int]:
    """Splats whose values are not yet read, the number of voxels and the hash."""
    if len(data) < _HEAD.size:
        raise ValueError(f"{len(data)} bytes, at least {_HEAD.size} are needed")
    rows, voxels, properties, reserved, content = _HEAD.unpack_from(data)
    names, steps, at = [], [], _HEAD.size
    for _ in range(properties):
        if at + _PROPERTY.size > len(data):
            raise ValueError("the section ends in a property")
        step, length = _PROPERTY.unpack_from(data, at)
        at += _PROPERTY.size + length
        names.append(bytes(data[at - length : at]).decode("latin-1"))
        steps.append(step)
    if at != len(data) or reserved != 0 or voxels > rows:
        raise ValueError("its length or its counts do not agree")
    empty = np.broadcast_to(np.zeros((), np.int32), (rows, properties))
    splats = QuantizedSplats(names, steps, empty)
    splats.check()
    return splats, voxels, content


def _hash(values: Ints) -> int:
    return _codec.xxh64(np.ascontiguousarray(values, "<i4"))
