"""PLY files with one table of numbers: the element "vertex" of scalar properties.

Little-endian, big-endian and ASCII are read, little-endian is written. The header is believed only
if the size of the file agrees with it. Source of the format: Turk, "The PLY Polygon File Format".
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.errors import DataError

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

MAX_HEADER = 1 << 16
MAX_PROPERTIES = 1024


@dataclass(frozen=True)
class PlyTable:
    """Columns by name, all (N,), in file order; and the lines of comment."""

    columns: dict[str, npt.NDArray[Any]]
    comments: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


@dataclass
class _Header:
    """What the header says; ``rows`` of the table, ``alone``: nothing follows it."""

    order: str | None = None
    rows: int | None = None
    alone: bool = True
    properties: list[tuple[str, str]] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)

    def dtype(self) -> np.dtype[Any]:
        """The type of a row."""
        order = self.order or "<"
        return np.dtype([(name, order + kind) for name, kind in self.properties])


def read_ply(path: Path) -> PlyTable:
    """The element "vertex" of a PLY file, which must be the first; later elements are skipped.

    Raises:
        DataError: missing, no PLY file, cut, damaged, compressed, or with lists in the table.
    """
    if path.exists() and not path.is_dir() and not path.is_file():
        raise DataError(f"{path}: not a regular file; name a PLY file")
    try:
        data = path.read_bytes()
        if not data.startswith(b"ply"):
            raise DataError(f"{path}: not a PLY file; name one")
        if _is_compressed(data):
            raise DataError(
                f"{path}: a compressed PLY file of SuperSplat / PlayCanvas; export it there as "
                "PLY, not as compressed PLY"
            )
        return parse_ply(data)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; name a .ply file") from None
    except IsADirectoryError:
        raise DataError(f"{path}: is a folder; name a PLY file") from None
    except ValueError as error:
        raise DataError(f"{path}: {error}; write the file again") from None


def _is_compressed(data: bytes) -> bool:
    """Whether the header is that of a PLY file of splats in chunks, each number a few bits."""
    header = data[: max(data.find(b"end_header", 0, MAX_HEADER), 0)]
    return b"\nelement chunk " in header and b" packed_position" in header


def parse_ply(data: bytes) -> PlyTable:
    """The element "vertex" of the bytes of a PLY file.

    Raises:
        ValueError: cut, damaged, or with lists in the table.
    """
    header, start = _read_header(data)
    assert header.rows is not None
    body, dtype = memoryview(data)[start:], header.dtype()
    if header.order == "":
        return PlyTable(_parse_text(body, header), header.comments)
    needed = header.rows * dtype.itemsize
    if len(body) < needed or (header.alone and len(body) > needed):
        raise ValueError(f"{len(body)} bytes follow the header, which promises {needed}")
    rows = np.frombuffer(body, dtype, header.rows)
    native = {name: np.ascontiguousarray(rows[name], kind) for name, kind in header.properties}
    return PlyTable(native, header.comments)


def _parse_text(body: memoryview, header: _Header) -> dict[str, npt.NDArray[Any]]:
    assert header.rows is not None
    count = header.rows * len(header.properties)
    if count * 2 - 1 > len(body):
        raise ValueError(f"{len(body)} bytes cannot hold {count} numbers")
    words = bytes(body).split(None, count)
    if len(words) < count or (header.alone and len(words) > count):
        raise ValueError(f"{len(words)} numbers follow the header, which promises {count}")
    numbers = np.array([float(word) for word in words[:count]])
    values = numbers.reshape(header.rows, len(header.properties))
    columns = {}
    for index, (name, kind) in enumerate(header.properties):
        columns[name] = _column(values[:, index], name, kind)
    return columns


def _column(values: npt.NDArray[np.float64], name: str, kind: str) -> npt.NDArray[Any]:
    """Numbers of an ASCII file as their property's type, which must hold them."""
    if kind[0] == "f":
        with np.errstate(over="ignore"):
            return values.astype(kind)
    limits = np.iinfo(kind)
    if not ((values >= limits.min) & (values <= limits.max) & (np.rint(values) == values)).all():
        raise ValueError(f"property {name} is of type {NAMES[kind]}, which cannot hold its values")
    return values.astype(kind)


def _read_header(data: bytes) -> tuple[_Header, int]:
    """The header, and the byte at which the table begins."""
    if data[: data.find(b"\n", 0, 8) + 1].split() != [b"ply"]:
        raise ValueError("not a PLY file")
    header = _Header()
    for number, (line, end) in enumerate(_header_lines(data), 1):
        if line.split() == ["end_header"]:
            if header.order is None or header.rows is None or not header.properties:
                problem = "names no format, or no element vertex with properties"
                raise ValueError(f"the header {problem}")
            return header, end
        try:
            _read_line(header, line.split() if number > 1 else [])
        except (ValueError, IndexError, KeyError) as error:
            shown, why = line.strip()[:60], ""
            if isinstance(error, ValueError) and str(error):
                why = f": {error}"
            raise ValueError(f"line {number} of the header, {shown!r}, is not read{why}") from None
    raise ValueError(f"no end of the header in the first {MAX_HEADER} bytes")


def _header_lines(data: bytes) -> Iterator[tuple[str, int]]:
    """The lines that end in the first MAX_HEADER bytes, each with the position after it.

    They are UTF-8, as far as they are text; other bytes of comments do no harm.
    """
    start = 0
    while stop := data.find(b"\n", start, MAX_HEADER) + 1:
        yield data[start:stop].decode("utf-8", "replace"), stop
        start = stop


def _read_line(header: _Header, words: list[str]) -> None:
    """Take a line of the header; IndexError, KeyError or ValueError if it makes no sense."""
    match words:
        case [] | ["obj_info", *_]:
            return
        case ["comment", *rest]:
            header.comments.append(" ".join(rest))
        case ["format", name, "1.0"] if header.order is None:
            header.order = FORMATS[name]
        case ["element", "vertex", count] if header.rows is None and header.alone:
            if not (count.isascii() and count.isdecimal() and len(count) < 19):
                raise ValueError("the number of rows is no whole number")
            header.rows = int(count)
        case ["element", _, _] if header.rows is not None:
            header.alone = False
        case ["property", *_] if not header.alone:
            return
        case ["property", kind, name] if header.rows is not None:
            _add_property(header, name, TYPES[kind])
        case _:
            raise ValueError


def _add_property(header: _Header, name: str, kind: str) -> None:
    if name in dict(header.properties):
        raise ValueError(f"there are two properties {name}")
    if len(header.properties) == MAX_PROPERTIES:
        raise ValueError(f"there are more than {MAX_PROPERTIES} properties")
    header.properties.append((name, kind))


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
    out = io.BytesIO()
    out.write("\n".join([*lines, "end_header\n"]).encode())
    out.write(rows.tobytes())
    return out.getvalue()


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
