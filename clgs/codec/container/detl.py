"""Section DETL: the precision that the last layer of a file adds to anchors (codec_c/FORMAT.md).

Chunks hold values divided by an odd step and rounded; their details are what is left of them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec.container.chunks import TAGS, ByteRange
from clgs.scene.anchors import QuantizedAnchors

ROWS = TAGS[1:]
"""The sections that have details, in the order of the columns."""

STEP, MAX_STEP = 3, 255
"""The step that is written, and the greatest. At 5, all anchors of fox have 6 dB less than at 3."""

MAX_VALUE = 1 << 30
"""Values are divided if all are below it, so that no product leaves int32."""

_HEAD = struct.Struct("<7I")


@dataclass(frozen=True)
class Details:
    """What DETL says.

    headers: for each of ROWS the bytes in BODY that all chunks share, with their CRC; starts (n, 3)
    and lengths (n, 3): bytes of each chunk for each of ROWS, one after the other, in BODY; crcs:
    (n,) of these; size: bytes of all details in BODY.
    """

    step: int
    headers: dict[str, tuple[ByteRange, int]]
    starts: npt.NDArray[np.int64]
    lengths: npt.NDArray[np.int32]
    crcs: npt.NDArray[np.uint32]
    size: int

    def places(self, chunk: int) -> dict[str, ByteRange]:
        """The bytes of a chunk in BODY for each of ROWS."""
        parts = zip(self.starts[chunk].tolist(), self.lengths[chunk].tolist(), strict=True)
        return dict(zip(ROWS, (ByteRange(*part) for part in parts), strict=True))


def pack_details(step: int, coded: dict[str, tuple[bytes, list[bytes]]]) -> tuple[bytes, bytes]:
    """Section DETL, and what follows the chunks in BODY.

    ``coded`` has for each of ROWS the header that chunks share, and the details of each chunk.
    """
    headers, streams = zip(*(coded[tag] for tag in ROWS), strict=True)
    parts = [b"".join(chunk) for chunk in zip(*streams, strict=True)]
    shared = [number for header in headers for number in (len(header), _codec.crc32c(header))]
    crcs = struct.pack(f"<{len(parts)}I", *map(_codec.crc32c, parts))
    sizes = np.array([[len(data) for data in stream] for stream in streams], np.int32).T
    listed = _codec.runlength_encode(np.ascontiguousarray(sizes), len(ROWS))
    section = _HEAD.pack(step, *shared) + crcs + listed
    return section, b"".join([*headers, *parts])


def unpack_details(data: bytes | memoryview, chunks: int, begin: int) -> Details:
    """What DETL says of a file of ``chunks`` chunks, which end at byte ``begin`` of BODY.

    Raises:
        ValueError: it is cut, or a number is out of range.
    """
    if len(data) < _HEAD.size + 4 * chunks:
        raise ValueError(f"{len(data)} bytes cannot hold {chunks} chunks")
    step, *shared = _HEAD.unpack_from(data)
    if step % 2 == 0 or step > MAX_STEP:
        raise ValueError(f"step {step} is not an odd number up to {MAX_STEP}")
    crcs = np.frombuffer(data, "<u4", chunks, _HEAD.size)
    lengths = np.empty((chunks, len(ROWS)), np.int32)
    _codec.runlength_decode(data[_HEAD.size + 4 * chunks :], lengths, len(ROWS))
    if (lengths < 0).any():
        raise ValueError("a chunk has a negative length")
    first = list(accumulate(shared[::2], initial=begin))
    ranges = (ByteRange(at, length) for at, length in zip(first, shared[::2], strict=False))
    headers = dict(zip(ROWS, zip(ranges, shared[1::2], strict=True), strict=True))
    ends = first[-1] + np.cumsum(lengths, dtype=np.int64).reshape(lengths.shape)
    end = int(ends[-1, -1]) if chunks else first[-1]
    return Details(step, headers, ends - lengths, lengths, crcs, end - begin)


def round_attributes(anchors: QuantizedAnchors) -> tuple[QuantizedAnchors, int]:
    """The anchors with all but positions rounded to multiples of a step, and this step."""
    arrays = [array for name, array in anchors.items() if name != "position"]
    step = (
        STEP if all(-MAX_VALUE < array.min() <= array.max() < MAX_VALUE for array in arrays) else 1
    )
    rounded = ((array + step // 2) // step * step for array in arrays)
    return QuantizedAnchors(anchors.position, *rounded), step


def times(coarse: npt.NDArray[np.int32], step: int) -> npt.NDArray[np.int32]:
    """Coarse values as integers of the scene; ValueError if they are outside of int32."""
    values = coarse.astype(np.int64) * step
    if values.size and (values.min() < -(2**31) or values.max() >= 2**31):
        raise ValueError("a coarse value is outside of int32")
    return values.astype(np.int32)


def interleave(
    coarse: npt.NDArray[np.int32], rest: npt.NDArray[np.int32] | int = 0
) -> npt.NDArray[np.int32]:
    """Rows (n, 2 C) of each coarse value and what is left of it, as the attribute coder has it."""
    both = np.empty((len(coarse), 2 * coarse.shape[1]), np.int32)
    both[:, ::2], both[:, 1::2] = coarse, rest
    return both


def known_channels(channels: int) -> npt.NDArray[np.bool_]:
    """Which of 2 C = ``channels`` interleaved ones a reader has: the coarse values."""
    return np.array([channel % 2 == 0 for channel in range(channels)])
