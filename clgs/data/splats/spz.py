"""SPZ files of Niantic, versions 1 to 4: quantised, compressed by gzip or, in version 4, by zstd.

A header, then by attribute: positions (24-bit fixed point, in version 1 halves), opacities, base
colors, log scales (bytes), rotations (up to version 2 three bytes, later the three smallest
components of the quaternion, 10 bits each), and the other coefficients of the color (bytes,
coefficient by coefficient, channels within). Extensions, such as limits of a camera, are passed
over. The axes stay as they are: splat-transform and gsply turn none either between PLY and SPZ.

Source of the format: Niantic's description (github.com/nianticlabs/spz, README).
"""

from __future__ import annotations

import struct
import zlib
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.splats.ply import PlyTable
from clgs.files import check_declared
from clgs.scene.gaussians import from_smallest_three, logit

GZIP, MAGIC = b"\x1f\x8b", b"NGSP"
HEAD = struct.Struct("<4sIIBBBB")
VERSIONS = (1, 2, 3, 4)
ZSTD_VERSION, ZSTD_HEAD = 4, 32
ANTIALIASED_FLAG, EXTENSIONS_FLAG = 1, 2
MAX_SH_DEGREE = 4
"""The highest degree of the colors that the format knows."""
MAX_FRACTION_BITS = 24
"""Coordinates have no more in all."""
COLOR_SCALE = 0.15 * 255
SCALE_STEPS, SCALE_LEAST = 16.0, -10.0
"""The steps per unit of a log scale, and the least log scale."""
SH_STEPS = 128.0
ROTATION_STEPS = 511

Bytes = npt.NDArray[np.uint8]


def decode_spz(data: bytes) -> PlyTable:
    """The columns of an SPZ file by the names of 3DGS's properties.

    Raises:
        ValueError: cut, damaged, or of another version.
    """
    body = data
    if data[:2] == GZIP:
        body = _inflate(data, HEAD.size)
    if len(body) < HEAD.size:
        raise ValueError("an .spz file that ends in its header")
    magic, version, count, degree, fraction, flags, streams = HEAD.unpack_from(body)
    if magic != MAGIC:
        raise ValueError("a file compressed by gzip, but no .spz file")
    if version not in VERSIONS:
        raise ValueError(f"an .spz file of version {version}; 1 to 4 are read")
    if degree > MAX_SH_DEGREE:
        raise ValueError(f"an .spz file with colors of degree {degree}")
    if fraction > MAX_FRACTION_BITS:
        raise ValueError(f"an .spz file whose coordinates have {fraction} bits after the point")
    rest = 3 * ((degree + 1) ** 2 - 1)
    widths = [6 if version == 1 else 9, 1, 3, 3, 3 if version < 3 else 4]
    widths += [rest] if degree else []
    check_declared(sum(widths) * count, len(data))
    if version == ZSTD_VERSION:
        parts = _decompress(data, [width * count for width in widths], streams)
    else:
        length = HEAD.size + sum(widths) * count
        body = _inflate(data, length, whole=not flags & EXTENSIONS_FLAG)
        ends = np.cumsum([HEAD.size, *(width * count for width in widths)])
        if len(body) < ends[-1]:
            raise ValueError(f"an .spz file that lacks the last of its {count} splats")
        parts = [body[first:end] for first, end in pairwise(ends)]
    rows = [
        np.frombuffer(part, np.uint8).reshape(count, width)
        for part, width in zip(parts, widths, strict=True)
    ]
    comments = ["antialiased 1"] if flags & ANTIALIASED_FLAG else []
    return PlyTable(_columns(rows, fraction), comments)


def _columns(rows: list[Bytes], fraction: int) -> dict[str, npt.NDArray[Any]]:
    """The columns of the rows of bytes of each attribute."""
    position, opacity, color, scale, rotation = rows[:5]
    count = len(position)
    if position.shape[1] == 6:
        mean = np.ascontiguousarray(position).view("<f2").astype(np.float64)
    else:
        padded = np.zeros((count, 3, 4), np.uint8)
        padded[..., 1:] = position.reshape(count, 3, 3)
        mean = (padded.view("<i4")[..., 0] >> 8) / 2.0**fraction  # the sign comes along
    found: dict[str, npt.NDArray[Any]] = {axis: mean[:, i] for i, axis in enumerate("xyz")}
    found |= {f"f_dc_{i}": (color[:, i] - 127.5) / COLOR_SCALE for i in range(3)}
    if len(rows) > 5:
        width = rows[5].shape[1]
        coefficients = (rows[5].reshape(count, width // 3, 3) - SH_STEPS) / SH_STEPS
        for i, column in enumerate(coefficients.transpose(2, 1, 0).reshape(width, count)):
            found[f"f_rest_{i}"] = column
    found["opacity"] = logit(opacity[:, 0] / 255.0)
    found |= {f"scale_{i}": scale[:, i] / SCALE_STEPS + SCALE_LEAST for i in range(3)}
    unit = _first_three(rotation) if rotation.shape[1] == 3 else _smallest_three(rotation)
    found |= {f"rot_{i}": unit[:, (i + 3) % 4] for i in range(4)}  # x y z w to w x y z
    return {name: np.asarray(column, np.float32) for name, column in found.items()}


def _first_three(rotation: Bytes) -> npt.NDArray[np.float64]:
    """Quaternions x y z w of x, y and z in bytes."""
    first = rotation / 127.5 - 1
    last = np.sqrt(np.maximum(0.0, 1 - np.square(first).sum(axis=1, keepdims=True)))
    return np.concatenate([first, last], axis=1)


def _smallest_three(rotation: Bytes) -> npt.NDArray[np.float64]:
    """Quaternions x y z w of words: two bits for the largest, sign and size of each other."""
    words = np.ascontiguousarray(rotation).view("<u4")[:, 0].astype(np.int64)
    fields = np.stack([words >> shift & 1023 for shift in (20, 10, 0)], axis=1)
    sizes = (fields & 511) * np.where(fields >> 9, -1, 1)
    return from_smallest_three(words >> 30, sizes / (ROTATION_STEPS * np.sqrt(2)))


def _inflate(data: bytes, most: int, whole: bool = False) -> bytes:
    """The first ``most`` bytes of what gzip compressed; with ``whole`` its checksum counts."""
    try:
        stream = zlib.decompressobj(wbits=31)
        body = stream.decompress(data, most)
        if len(body) < most and stream.unused_data[:2] == GZIP:
            raise ValueError("an .spz file of several gzip members; compress it as one")
        if whole and len(body) == most:
            stream.decompress(stream.unconsumed_tail, 1)
            if not stream.eof:
                raise ValueError("an .spz file that does not end with its splats")
        return body
    except zlib.error as error:
        raise ValueError(f"an .spz file that gzip cannot read ({error})") from None


def _decompress(data: bytes, sizes: list[int], streams: int) -> list[bytes]:
    """The attributes of a file of version 4: their streams lie behind a table of their sizes."""
    import zstandard

    if len(data) < ZSTD_HEAD:
        raise ValueError("an .spz file that ends in its header")
    at = struct.unpack_from("<I", data, HEAD.size)[0]
    begin = at + 16 * len(sizes)
    if streams != len(sizes) or at < ZSTD_HEAD or begin > len(data):
        raise ValueError("an .spz file whose table of streams is damaged")
    found = []
    for i, size in enumerate(sizes):
        packed, declared = struct.unpack_from("<QQ", data, at + 16 * i)
        part = data[begin : begin + packed]
        begin += packed
        try:
            held = zstandard.frame_content_size(part) if size else 0
            if declared != size or held not in (size, -1) or len(part) < packed:
                raise ValueError(f"an .spz file whose stream {i + 1} is not as long as it must be")
            reader = zstandard.ZstdDecompressor()
            found.append(reader.decompress(part, max_output_size=size) if size else b"")
        except zstandard.ZstdError as error:
            raise ValueError(f"an .spz file that zstd cannot read ({error})") from None
        if len(found[-1]) != size:
            raise ValueError(f"an .spz file whose stream {i + 1} is not as long as it must be")
    return found
