"""PLY files: elements that are tables of numbers, above all the element "vertex".

Little-endian, big-endian and ASCII are read, little-endian is written. The header is believed only
if the size of the file agrees with it. Source of the format: Turk, "The PLY Polygon File Format".

In the compressed files of SuperSplat and splat-transform, 256 splats are a chunk and share the
limits of their positions, log scales and, in newer files, colors. A splat is four words of 32 bits:
position and scale of 11, 10 and 11 bits, rotation as the smallest three components of the
quaternion, color and opacity of 8 bits each. The coefficients of the colors are bytes. Source of
the format: PlayCanvas' reader (github.com/playcanvas/splat-transform).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from clgs.errors import DataError
from clgs.scene.gaussians import SH_0, from_smallest_three, logit

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
"""NumPy's names of the types of properties."""

NAMES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint"} | {
    "f4": "float",
    "f8": "double",
}

FORMATS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}

NOT_PLY = "not a PLY file"
MAX_HEADER = 1 << 16
MAX_PROPERTIES = 1024


@dataclass(frozen=True)
class PlyTable:
    """Columns by name, all (N,), in file order; and the lines of comment and obj_info."""

    columns: dict[str, npt.NDArray[Any]]
    comments: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


@dataclass
class _Element:
    """What the header says of an element; a list has its two types as its kind, "u1 i4"."""

    name: str
    rows: int
    properties: list[tuple[str, str]] = field(default_factory=list)

    @property
    def has_lists(self) -> bool:
        """Whether rows may differ in length."""
        return any(" " in kind for _, kind in self.properties)

    def dtype(self, order: str) -> np.dtype[Any]:
        """The type of a row without lists."""
        return np.dtype([(name, order + kind) for name, kind in self.properties])


@dataclass
class _Header:
    order: str | None = None
    elements: list[_Element] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)


def read_ply(path: Path) -> PlyTable:
    """The element "vertex" of a PLY file; the others are skipped.

    Raises:
        DataError: missing, no PLY file, cut, damaged, or with lists in the table.
    """
    with reading(path):
        return parse_ply(path.read_bytes())


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Let what goes wrong with a file of splats be a DataError that names it."""
    if path.exists() and not path.is_dir() and not path.is_file():
        raise DataError(f"{path}: not a regular file; name a PLY file")
    try:
        yield
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; name a .ply file") from None
    except IsADirectoryError:
        raise DataError(f"{path}: is a folder; name a PLY file") from None
    except ValueError as error:
        text = str(error)
        remedy = "name one" if text == NOT_PLY else "write the file again"
        raise DataError(f"{path}: {text}; {remedy}") from None


def parse_ply(data: bytes) -> PlyTable:
    """The element "vertex" of the bytes of a PLY file.

    Raises:
        ValueError: cut, damaged, or with lists in the table.
    """
    return parse_elements(data, ("vertex",))["vertex"]


def element_names(data: bytes) -> list[str]:
    """The elements of a PLY file by its header; none if that cannot be read."""
    try:
        return [element.name for element in _read_header(data)[0].elements]
    except ValueError:
        return []


def parse_elements(data: bytes, names: Sequence[str]) -> dict[str, PlyTable]:
    """Elements of the bytes of a PLY file by name, each with the comments of the file.

    Raises:
        ValueError: cut, damaged, an element is missing, or there are lists in one of them.
    """
    header, start = _read_header(data)
    order, body = header.order, memoryview(data)[start:]
    if order is None:
        raise ValueError("the header names no format")
    words = bytes(body).split() if order == "" else []
    if order == "" and b"_" in bytes(body):  # which Python takes between digits
        raise ValueError("a number has an underscore")
    found: dict[str, PlyTable] = {}
    at = 0
    for element in header.elements:
        if len(found) == len(names):
            return found
        wanted = element.name in names
        if wanted and (element.has_lists or not element.properties):
            lack = "no properties" if not element.properties else "lists among its properties"
            raise ValueError(f"the header has element {element.name} with {lack}")
        if element.has_lists:
            at = _skip_lists(words or body, at, element, order)
            continue
        columns, at = _read_rows(words, body, at, element, order, wanted)
        if wanted:
            found[element.name] = PlyTable(columns, header.comments)
    if missing := [name for name in names if name not in found]:
        raise ValueError(f"the header has no element {missing[0]} with properties")
    if at < (length := len(words) if order == "" else len(body)):
        what = "numbers" if order == "" else "bytes"
        raise ValueError(f"{length} {what} follow the header, which promises {at}")
    return found


def _read_rows(
    words: list[bytes], body: memoryview, at: int, element: _Element, order: str, wanted: bool
) -> tuple[dict[str, npt.NDArray[Any]], int]:
    """The columns of an element that begins at a word or byte, and where it ends."""
    if order != "":
        dtype = element.dtype(order)
        end = at + element.rows * dtype.itemsize
        if end > len(body):
            raise ValueError(f"{len(body)} bytes follow the header, which promises {end}")
        rows = np.frombuffer(body, dtype, element.rows, at) if end > at else np.empty(0, dtype)
        properties = element.properties if wanted else []
        return {name: np.ascontiguousarray(rows[name], kind) for name, kind in properties}, end
    end = at + element.rows * len(element.properties)
    if end > len(words):
        raise ValueError(f"{len(words)} numbers follow the header, which promises {end}")
    if not wanted:
        return {}, end
    numbers = np.array([float(word) for word in words[at:end]])
    values = numbers.reshape(element.rows, len(element.properties))
    pairs = enumerate(element.properties)
    return {name: _column(values[:, i], name, kind) for i, (name, kind) in pairs}, end


def _skip_lists(data: list[bytes] | memoryview, at: int, element: _Element, order: str) -> int:
    """Where an element with lists ends that begins at a word or byte of ``data``."""
    for _ in range(element.rows):
        for _, kind in element.properties:
            count_kind, _, item_kind = kind.rpartition(" ")
            count = 1
            if count_kind and at < len(data):
                if isinstance(data, list):
                    count, at = int(data[at]), at + 1
                else:
                    size = np.dtype(count_kind).itemsize
                    sign = count_kind[0] == "i"
                    byte_order: Literal["big", "little"] = "big" if order == ">" else "little"
                    count = int.from_bytes(data[at : at + size], byte_order, signed=sign)
                    at += size
            at += count if isinstance(data, list) else count * np.dtype(item_kind).itemsize
            if count < 0 or at > len(data):
                raise ValueError(f"element {element.name} is longer than the file")
    return at


def _column(values: npt.NDArray[np.float64], name: str, kind: str) -> npt.NDArray[Any]:
    """Numbers of an ASCII file as their property's type, which must hold them.

    Coordinates of type float keep their digits: far from the origin float32 moves them.
    """
    if kind[0] == "f":
        with np.errstate(over="ignore"):
            typed = values.astype(kind)
        moved = np.isfinite(typed) & (typed != values)
        return values if name in ("x", "y", "z") and moved.any() else typed
    limits = np.iinfo(kind)
    if not ((values >= limits.min) & (values <= limits.max) & (np.rint(values) == values)).all():
        raise ValueError(f"property {name} is of type {NAMES[kind]}, which cannot hold its values")
    return values.astype(kind)


def _read_header(data: bytes) -> tuple[_Header, int]:
    """The header, and the byte at which the elements begin."""
    if data[: data.find(b"\n", 0, 8) + 1].split() != [b"ply"]:
        raise ValueError(NOT_PLY)
    header, number, end = _Header(), 0, 0
    while stop := data.find(b"\n", end, MAX_HEADER) + 1:
        # UTF-8, as far as it is text; other bytes of comments do no harm
        line, end, number = data[end:stop].decode("utf-8", "replace"), stop, number + 1
        if line.split() == ["end_header"]:
            return header, end
        try:
            _read_line(header, line.split() if number > 1 else [])
        except (ValueError, IndexError, KeyError) as error:
            shown, why = line.strip()[:60], ""
            if isinstance(error, ValueError) and str(error):
                why = f": {error}"
            raise ValueError(f"line {number} of the header, {shown!r}, is not read{why}") from None
    raise ValueError(f"no end of the header in the first {MAX_HEADER} bytes")


def _read_line(header: _Header, words: list[str]) -> None:
    """Take a line of the header; IndexError, KeyError or ValueError if it makes no sense."""
    match words:
        case []:
            return
        case ["comment" | "obj_info", *rest]:
            header.comments.append(" ".join(rest))
        case ["format", name, "1.0"] if header.order is None:
            header.order = FORMATS[name]
        case ["element", name, count]:
            if not (count.isascii() and count.isdecimal() and len(count) < 19):
                raise ValueError("the number of rows is no whole number")
            if name in (element.name for element in header.elements):
                raise ValueError(f"there are two elements {name}")
            header.elements.append(_Element(name, int(count)))
        case ["property", "list", count_kind, kind, name]:
            if TYPES[count_kind][0] == "f":
                raise ValueError("a list has a whole number of items")
            _add_property(header.elements[-1], name, f"{TYPES[count_kind]} {TYPES[kind]}")
        case ["property", kind, name]:
            _add_property(header.elements[-1], name, TYPES[kind])
        case _:
            raise ValueError


def _add_property(element: _Element, name: str, kind: str) -> None:
    if name in dict(element.properties):
        raise ValueError(f"there are two properties {name}")
    if len(element.properties) == MAX_PROPERTIES:
        raise ValueError(f"there are more than {MAX_PROPERTIES} properties")
    element.properties.append((name, kind))


def pack_ply(table: PlyTable) -> bytes:
    """The little-endian file of a table."""
    kinds = {name: column.dtype.str[1:] for name, column in table.columns.items()}
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {comment}" for comment in table.comments]
    lines += [f"element vertex {len(table)}"]
    lines += [f"property {NAMES[kind]} {name}" for name, kind in kinds.items()]
    rows = np.empty(len(table), [(name, f"<{kind}") for name, kind in kinds.items()])
    for name, column in table.columns.items():
        rows[name] = column
    return "\n".join([*lines, "end_header\n"]).encode() + rows.tobytes()


def narrowest(
    integers: npt.NDArray[np.int32],
    decode: Callable[[npt.NDArray[np.int32]], npt.NDArray[np.float64]],
    encode: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]],
) -> npt.NDArray[np.float32] | npt.NDArray[np.float64]:
    """The column ``decode(integers)`` as float32, or float64 if float32 would lose an integer.

    Args:
        integers: (N,).
        decode: the numbers that the integers stand for.
        encode: its inverse but for rounding; a reader rounds the result.
    """
    values = decode(integers)
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
        same = np.rint(encode(single.astype(np.float64))) == integers
    return single if same.all() else values


CHUNK = 256
PACKED = [f"packed_{part}" for part in ("position", "rotation", "scale", "color")]
SH_RANGE = 8.0

Words = npt.NDArray[np.uint32]
Floats = npt.NDArray[np.float64]


def decode_chunks(data: bytes) -> PlyTable:
    """The columns of a compressed PLY file by the names of 3DGS's properties.

    Raises:
        ValueError: cut, damaged, or not of this kind.
    """
    wanted = ["chunk", "vertex", *(["sh"] if "sh" in element_names(data) else [])]
    elements = parse_elements(data, wanted)
    chunk, vertex = elements["chunk"].columns, elements["vertex"].columns
    for name in PACKED:
        if vertex.get(name, np.zeros(0)).dtype != np.uint32:
            raise ValueError(f"there are chunks, but no property {name} of type uint")
    position, rotation, scale, color = (vertex[name] for name in PACKED)
    count = len(position)
    for name, rows in (("chunk", -(-count // CHUNK)), ("sh", count)):
        if name in elements and len(elements[name]) != rows:
            raise ValueError(
                f"{len(elements[name])} rows of {name} are not those of {count} splats"
            )
    limits = {name: np.repeat(column, CHUNK)[:count] for name, column in chunk.items()}
    columns: dict[str, npt.NDArray[Any]] = {}
    for words, prefix, suffixes in ((position, "", "xyz"), (scale, "scale_", "012")):
        fields = zip("xyz", suffixes, (21, 11, 0), (11, 10, 11), strict=True)
        for axis, suffix, shift, bits in fields:
            columns[prefix + suffix] = _between(limits, prefix + axis, _share(words, shift, bits))
    small = np.stack([_share(rotation, shift, 10) - 0.5 for shift in (20, 10, 0)], 1) * np.sqrt(2)
    unit = from_smallest_three((rotation >> np.uint32(30)).astype(np.int64), small)
    columns |= {f"rot_{i}": unit[:, i] for i in range(4)}
    for i, (primary, shift) in enumerate(zip("rgb", (24, 16, 8), strict=True)):
        share = _share(color, shift, 8)
        value = _between(limits, primary, share) if "min_r" in limits else share
        columns[f"f_dc_{i}"] = (value - 0.5) / SH_0
    columns["opacity"] = logit(_share(color, 0, 8))
    if "sh" in elements:
        columns |= {name: _coefficient(one) for name, one in elements["sh"].columns.items()}
    single = {name: np.asarray(column, np.float32) for name, column in columns.items()}
    return PlyTable(single, elements["vertex"].comments)


def _share(words: Words, shift: int, bits: int) -> Floats:
    """Some bits of each word as a number from 0 to 1."""
    most = (1 << bits) - 1
    return np.asarray((words >> np.uint32(shift) & np.uint32(most)) / most, np.float64)


def _between(limits: dict[str, npt.NDArray[Any]], name: str, share: Floats) -> Floats:
    """The numbers at these shares of the way from the least to the greatest of their chunks."""
    try:
        least, most = (limits[f"{end}_{name}"].astype(np.float64) for end in ("min", "max"))
    except KeyError as error:
        raise ValueError(f"property {error.args[0]} of element chunk is missing") from None
    return np.asarray(least * (1 - share) + most * share)


def _coefficient(column: npt.NDArray[Any]) -> Floats:
    """Coefficients of bytes: the middles of 256 parts of their range, and its ends."""
    if column.dtype != np.uint8:
        raise ValueError("a property of element sh is no uchar")
    share = np.where(column % 255 == 0, column / 255.0, (column + 0.5) / 256.0)
    return np.asarray((share - 0.5) * SH_RANGE)
