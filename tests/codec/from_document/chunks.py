"""Part 5: which bytes belong to which chunk."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from tests.codec.from_document.common import ByteReader, check, crc32c, in_int32
from tests.codec.from_document.rows import decode_rows

COLUMNS = 11
SECTIONS = ("ANCH", "OFFS", "FEAT", "SCAL")


@dataclass
class Part:
    """A group or a chunk."""

    anchors: int
    least: list[int]
    greatest: list[int]
    sizes: list[int]  # bytes in ANCH, OFFS, FEAT, SCAL
    crc_anchors: int = 0
    crc_others: int = 0


@dataclass
class Chunks:
    """All that CHNK says."""

    header_lengths: list[int]
    header_crcs: list[int]
    chunks: list[Part]


def _parts(rows: list[list[int]], base: list[int], group: Part | None) -> list[Part]:
    """Rows as groups or, with the group that they are of, as chunks."""
    parts = []
    for row in rows:
        least = [b + v for b, v in zip(base, row[1:4], strict=True)]
        greatest = [b + v for b, v in zip(least, row[4:7], strict=True)]
        sizes = row[7:]
        if group is not None:
            check(row[0] >= 1, "CHNK: a chunk without anchors")
            sizes = [
                v + row[0] * s // group.anchors for v, s in zip(sizes, group.sizes, strict=True)
            ]
        check(min(row[4:7]) >= 0, "CHNK: greatest below least")
        check(min(sizes) >= 0, "CHNK: a negative number of bytes")
        parts.append(Part(row[0], least, greatest, sizes))
        base = least
    return parts


def _union(parts: list[Part]) -> Part:
    """The row of a group with these chunks."""
    return Part(
        sum(p.anchors for p in parts),
        [min(axis) for axis in zip(*(p.least for p in parts), strict=True)],
        [max(axis) for axis in zip(*(p.greatest for p in parts), strict=True)],
        [sum(sizes) for sizes in zip(*(p.sizes for p in parts), strict=True)],
    )


def _read_group(data: bytes, count: int, group: Part, most: int, number: int) -> list[Part]:
    """The chunks of a group."""
    what = f"CHNK group {number}"
    reader = ByteReader(data, what)
    crc_anchors = reader.fields(f"{count}I")
    crc_others = reader.fields(f"{count}I")
    rows = decode_rows(reader.rest(), count, COLUMNS, what)
    chunks = _parts(rows, group.least, group)
    for chunk, crc_a, crc_o in zip(chunks, crc_anchors, crc_others, strict=True):
        check(chunk.anchors <= most, f"{what}: a chunk of {chunk.anchors} anchors")
        check(chunk.anchors <= 32768 * chunk.sizes[0], f"{what}: too few bytes in ANCH")
        chunk.crc_anchors, chunk.crc_others = crc_a, crc_o
    check(_union(chunks) == group, f"{what}: chunks do not give the row of the head")
    return chunks


def read_chunks(
    data: bytes, lengths: list[int], n: int, origin: tuple[int, ...], depth: int
) -> Chunks:
    """All chunks; `lengths` of ANCH to SCAL in the section table, the others from META."""
    reader = ByteReader(data, "CHNK")
    most, count = reader.fields("2I")
    check(1 <= most <= 2**20, f"CHNK: chunks of {most} anchors")
    headers = reader.fields("8I")
    check(headers[0] == headers[1] == 0, "CHNK: ANCH has a header")
    size, head_crc = reader.fields("2I")
    group_count = (count + 63) // 64
    table = reader.take(8 * group_count)
    rows = reader.take(size)
    check(crc32c(data[:44] + table + rows) == head_crc, "CHNK: head CRC differs")
    groups = _parts(decode_rows(rows, group_count, COLUMNS, "CHNK head"), [0, 0, 0], None)
    sizes = [sum(g.sizes[k] for g in groups) for k in range(4)]
    for k, tag in enumerate(SECTIONS):
        check(headers[2 * k] + sizes[k] == lengths[k], f"CHNK: bytes of {tag} do not add up")
    check(sum(g.anchors for g in groups) == n, "CHNK: anchors of the groups do not add up")
    check(all(g.anchors >= 1 for g in groups), "CHNK: a group without anchors")
    if groups:
        whole = _union(groups)
        extent = max(g - o for g, o in zip(whole.greatest, origin, strict=True))
        corners = [v for g in groups for v in g.least + g.greatest]
        check(all(map(in_int32, corners)), "CHNK: corner outside of int32")
        check(whole.least == list(origin), "CHNK: least corner is not META's origin")
        check(extent.bit_length() == depth, "CHNK: extent is not META's depth")
    chunks: list[Part] = []
    for number, (length, crc) in enumerate(struct.iter_unpack("<2I", table)):
        part = reader.take(length)
        check(crc32c(part) == crc, f"CHNK group {number}: CRC differs")
        in_group = min(64, count - 64 * number)
        chunks += _read_group(part, in_group, groups[number], most, number)
    reader.finish()
    return Chunks(list(headers[::2]), list(headers[1::2]), chunks)
