"""Files with some of their bytes changed and every checksum made right."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np

from clgs import _codec
from clgs.codec import chunks
from clgs.codec.sections import (
    BODY,
    DETL,
    LAYR,
    SCENE,
    SPLATS,
    BytesSource,
    read_section,
    read_table,
    write_container,
)

ENTRY, HEAD = 32, 16


def contents(data: bytes) -> dict[str, bytes]:
    """The known sections of a file of a scene or of splats."""
    source = BytesSource(data)
    splats = data[HEAD : HEAD + 4] == b"SPLT"
    entries = read_table(source, splats).entries
    layered = [tag for tag in (LAYR, DETL, BODY) if tag in entries]
    tags = SPLATS if splats else (*SCENE, *layered)
    return {tag: bytes(read_section(source, entries[tag]).data) for tag in tags}


def rebuilt(data: bytes, **changed: bytes) -> bytes:
    """The file with sections replaced, and every checksum made right, those of chunks too."""
    sections = {**contents(data), **changed}
    if "CHNK" in sections and "CHNK" not in changed:
        sections["CHNK"] = checked(sections)
        if DETL in sections and DETL not in changed:
            sections[DETL] = checked_details(sections)
    return write_container(sections)


def checked_details(sections: dict[str, bytes]) -> bytes:
    """DETL with the checksums of the headers and of the details that BODY has now."""
    table = unpack_rows(sections["CHNK"])[-1]
    begin = int(table[:, 7:].sum())
    section, body = bytearray(sections[DETL]), sections[BODY]
    details = chunks.unpack_details(bytes(section), len(table), begin)
    for i, (place, _) in enumerate(details.headers.values()):
        crc = _codec.crc32c(body[place.offset : place.offset + place.length])
        struct.pack_into("<I", section, 8 + 8 * i, crc)
    for i, places in enumerate(all_places(details)):
        parts = [body[place.offset : place.offset + place.length] for place in places.values()]
        struct.pack_into("<I", section, 28 + 4 * i, _codec.crc32c(b"".join(parts)))
    return bytes(section)


def checked(sections: dict[str, bytes]) -> bytes:
    """CHNK with the checksums of what lies at its chunks' places now."""
    chunk, shared, _, table = unpack_rows(sections["CHNK"])
    streams: dict[str, list[bytes]] = {tag: [] for tag in chunks.TAGS}
    ends = {}
    for column, tag in enumerate(chunks.TAGS):
        ends[tag] = shared[2 * column]
        shared[2 * column + 1] = _codec.crc32c(sections[tag][: ends[tag]])
    home = {tag: BODY if BODY in sections else tag for tag in chunks.TAGS}
    ends[BODY] = 0
    for lengths in table[:, 7:].tolist():
        for tag, length in zip(chunks.TAGS, lengths, strict=True):
            at = ends[home[tag]]
            streams[tag].append(sections[home[tag]][at : at + length])
            ends[home[tag]] += length
    crcs = [_codec.crc32c(stream) for stream in streams["ANCH"]]
    rows = zip(*(streams[tag] for tag in chunks.TAGS[1:]), strict=True)
    crcs += [_codec.crc32c(b"".join(row)) for row in rows]
    return chunks.pack_rows(chunk, shared, crcs, table)


def unpack_rows(section: bytes) -> tuple[int, list[int], list[int], chunks.Rows]:
    """What ``chunks.pack_rows`` was given to make a CHNK that is not damaged."""
    head = chunks.unpack_head(section[: chunks.head_size(section)])
    listed: list[chunks.Chunk] = []
    for index, (place, _) in enumerate(head.places):
        data = section[place.offset : place.offset + place.length]
        listed += chunks.unpack_group(data, head, index)
    shared = [number for part, crc in head.headers.values() for number in (part.length, crc)]
    crcs = [chunk.position_crc for chunk in listed] + [chunk.rows_crc for chunk in listed]
    rows = [(len(c), *c.least, *c.greatest, *(p.length for p in c.places.values())) for c in listed]
    return head.chunk, shared, crcs, np.array(rows, np.int64).reshape(-1, chunks.COLUMNS)


def directory(data: bytes, change: Callable[..., None], fix: bool = False) -> bytes:
    """CHNK of the file after ``change(shared, crcs, table)``; with ``fix`` its checksums right."""
    chunk, shared, crcs, table = unpack_rows(contents(data)["CHNK"])
    change(shared, crcs, table)
    section = chunks.pack_rows(chunk, shared, crcs, table)
    return checked({**contents(data), "CHNK": section}) if fix else section


def sealed_directory(section: bytes) -> bytes:
    """A changed CHNK with the checksums of its groups and of its head right, if it has any."""
    out = bytearray(section)
    if len(out) < chunks.HEAD_SIZE or chunks.head_size(section) > len(out):
        return section
    end = at = chunks.head_size(section)
    count = int.from_bytes(out[4:8], "little")
    for entry in range(chunks.HEAD_SIZE, chunks.HEAD_SIZE + 8 * -(-count // chunks.GROUP), 8):
        length = int.from_bytes(out[entry : entry + 4], "little")
        crc = _codec.crc32c(bytes(out[at : at + length]))
        out[entry + 4 : entry + 8] = struct.pack("<I", crc)
        at += length
    own = chunks.HEAD_SIZE - 4
    head = bytes(out[:own] + out[chunks.HEAD_SIZE : end])
    out[own : chunks.HEAD_SIZE] = struct.pack("<I", _codec.crc32c(head))
    return bytes(out)


def patched(data: bytes, at: int, new: bytes) -> bytes:
    """The file with bytes of its header replaced and the header's checksum made right."""
    file = bytearray(data)
    file[at : at + len(new)] = new
    end = HEAD + ENTRY * int.from_bytes(data[12:16], "little")
    file[end : end + 4] = struct.pack("<I", _codec.crc32c(bytes(file[:end])))
    return bytes(file)


def all_places(details):
    """The bytes of the details of every chunk, in BODY."""
    return [details.places(chunk) for chunk in range(len(details.crcs))]
