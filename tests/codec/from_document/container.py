"""Part 2: sections and their checksums."""

from __future__ import annotations

from typing import NamedTuple

from tests.codec.from_document.common import ByteReader, check, crc32c

MAGIC = bytes.fromhex("8B434C47530D0A1A")
SCENE = ("META", "CHNK", "ANCH", "OFFS", "FEAT", "SCAL", "MLPS")
SPLATS = ("SPLT", "SPOS", "SMUL", "SATR")


class Entry(NamedTuple):
    """An entry of the section table."""

    tag: str
    required: bool
    offset: int
    length: int
    crc: int


def read_table(data: bytes) -> list[Entry]:
    """The section table of a file, verified."""
    check(data[:8] == MAGIC, "container: magic")
    reader = ByteReader(data, "container")
    _, _, major, _, count = reader.fields("IIHHI")
    check(major == 1, f"container: version {major} is not known")
    check(count <= 64, f"container: {count} sections")
    table = ByteReader(reader.take(32 * count), "section table")
    end = 16 + 32 * count
    crc = reader.number("I")
    check(crc == crc32c(data[:end]), "container: header CRC differs")
    entries: list[Entry] = []
    at = end + 4
    for _ in range(count):
        raw_tag = table.take(4)
        flags, offset, length, crc, zero = table.fields("IQQII")
        check(raw_tag.isalpha(), f"container: tag {raw_tag!r}")  # bytes: ASCII letters
        tag = raw_tag.decode("ascii")
        check(flags <= 1, f"{tag}: flags {flags}")
        check(zero == 0, f"{tag}: last field of the entry is not 0")
        check(offset == at, f"{tag}: a gap or an overlap")
        check(all(tag != entry.tag for entry in entries), f"{tag}: occurs twice")
        at += length
        entries.append(Entry(tag, flags == 1, offset, length, crc))
    check(at == len(data), f"container: sections end at {at}, the file at {len(data)}")
    return entries


def read_container(data: bytes) -> dict[str, bytes]:
    """The required sections of a scene or of a file of splats."""
    entries = read_table(data)
    for entry in entries:
        section = data[entry.offset : entry.offset + entry.length]
        check(crc32c(section) == entry.crc, f"{entry.tag}: CRC differs")
    splats = bool(entries) and entries[0].tag == "SPLT"
    required = SPLATS if splats else SCENE
    found = []
    for entry in entries:
        if entry.tag in required:
            check(entry.required, f"{entry.tag}: bit 0 of flags is not set")
            found.append(entry)
        else:
            check(not entry.required, f"{entry.tag}: an unknown section that is required")
    tags = tuple(entry.tag for entry in found)
    check(tags == required, f"container: sections {' '.join(tags)} missing or out of order")
    return {e.tag: data[e.offset : e.offset + e.length] for e in found}
