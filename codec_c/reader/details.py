"""Details, what the last layer of a file may add to attributes: 5.4 of FORMAT.md."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .attributes import Attributes, near_rows
from .coding import ByteReader, check, crc32c
from .rows import decode_rows

MOST = 255  # the greatest step


class Details(NamedTuple):
    """What section DETL says.

    `headers` has length and CRC of the header of each of OFFS, FEAT and SCAL; `sizes` has of each
    chunk the bytes of its details in these three, and `crcs` their CRC.
    """

    step: int
    headers: list[tuple[int, int]]
    sizes: list[list[int]]
    crcs: list[int]

    def total(self) -> int:
        """All bytes in BODY that are none of the chunks."""
        return sum(length for length, _ in self.headers) + sum(map(sum, self.sizes))


def read_details(data: bytes, chunks: int) -> Details:
    """Section DETL of a file of this many chunks."""
    reader = ByteReader(data)
    step, *numbers = reader.fields("7I")
    check(step % 2 == 1 and step <= MOST, f"DETL: the step is {step}")
    crcs = list(reader.fields(f"{chunks}I"))
    sizes = decode_rows(reader.rest(), chunks, 3)
    check(all(size >= 0 for row in sizes for size in row), "DETL: a negative number of bytes")
    return Details(step, list(zip(numbers[::2], numbers[1::2], strict=True)), sizes, crcs)


def products(rows: np.ndarray, details: Details) -> np.ndarray:
    """The attributes of a chunk in the scene without details."""
    found = rows.astype(np.int64) * details.step
    low, high = -(2**31), 2**31 - 1
    check(bool(((found >= low) & (found <= high)).all()), "a product is outside of int32")
    return found.astype("<i4")


def add_details(
    details: Details, body: ByteReader, arrays: tuple[np.ndarray, ...], counts: list[int]
) -> tuple[np.ndarray, ...]:
    """Positions and attributes of the scene, from those without details in the order of the file.

    `body` has read all chunks, of which `counts` has the numbers of anchors.
    """
    positions, *attributes = arrays
    decoders = []
    for rows, (length, crc) in zip(attributes, details.headers, strict=True):
        header = body.take(length)
        check(crc32c(header) == crc, "DETL: the CRC of a header differs")
        check(header[:1] == b"\1", "DETL: a header is of another mode")
        columns = 2 * rows.shape[1]
        decoders.append(Attributes(header, columns, [j % 2 == 0 for j in range(columns)]))
    sums = [[] for _ in attributes]
    first = 0
    for count, sizes, crc in zip(counts, details.sizes, details.crcs, strict=True):
        chunk, first = slice(first, first + count), first + count
        streams = [body.take(size) for size in sizes]
        check(crc32c(b"".join(streams)) == crc, "DETL: the CRC of the details of a chunk differs")
        near = near_rows(positions[chunk].tolist())
        for i, (decoder, data) in enumerate(zip(decoders, streams, strict=True)):
            sums[i].append(_sums(decoder, data, near, attributes[i][chunk], details.step))
    body.finish()
    return positions, *(np.concatenate(parts) for parts in sums)


def _sums(
    decoder: Attributes, data: bytes, near: list[list[int]], before: np.ndarray, step: int
) -> np.ndarray:
    """The attributes of a chunk, which are `before` without details."""
    known = np.zeros((len(before), decoder.columns), np.int32)
    known[:, ::2] = before // step
    added = decoder.decode(data, len(before), near, known)[:, 1::2]
    whole = before.astype(np.int64) + added
    return ((whole + 2**31) % 2**32 - 2**31).astype("<i4")
