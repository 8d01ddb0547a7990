"""The .clgs container: signature, section table, checksums (codec_c/FORMAT.md on the container)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from clgs import _codec
from clgs.codec.container.source import BytesSource, Source
from clgs.errors import CodecError

MAGIC = b"\x8bCLGS\r\n\x1a"
"""Not text (0x8B); the line ends and the DOS end-of-file expose transfers that alter them."""

META, CHNK, ANCH, OFFS, FEAT, SCAL, MLPS = "META", "CHNK", "ANCH", "OFFS", "FEAT", "SCAL", "MLPS"

SCENE = (META, CHNK, ANCH, OFFS, FEAT, SCAL, MLPS)
"""The required sections of a file that holds a scene, in file order."""

SPLT, SPOS, SMUL, SATR = "SPLT", "SPOS", "SMUL", "SATR"
SPLATS = (SPLT, SPOS, SMUL, SATR)
"""The required sections of a file that holds splats in place of a scene."""

MAJOR, MINOR = 1, 0
"""The version that is written. Every minor version of this major one can be read."""

REQUIRED = 1
"""Flag of a section that a reader must understand."""

MAX_SECTIONS = 64

_HEAD = struct.Struct("<8sHHI")
_ENTRY = struct.Struct("<4sIQQII")
_CRC = struct.Struct("<I")

_REMEDY = "the file is damaged; copy or encode it again"


@dataclass(frozen=True)
class Section:
    """One section: its tag, where it lies in the file (bytes), and its content."""

    tag: str
    offset: int
    data: memoryview

    def error(self, what: str) -> CodecError:
        """A CodecError that names this section and its place."""
        return damage(f"section {self.tag} at byte {self.offset}", what)


@dataclass(frozen=True)
class Entry:
    """One row of the section table; ``crc`` of the section's bytes."""

    tag: str
    offset: int
    length: int
    crc: int


@dataclass(frozen=True)
class Table:
    """What a file says of itself.

    ``version`` as "1.0"; ``entries``: the sections by tag, unknown ones included.
    """

    version: str
    entries: dict[str, Entry]


def damage(where: str, what: str) -> CodecError:
    """A CodecError for a damaged file."""
    return CodecError(f"{where}: {what}; {_REMEDY}")


def write_container(contents: dict[str, bytes]) -> bytes:
    """The file that holds ``contents`` (tag to bytes, all required), in the given order."""
    offset = _HEAD.size + len(contents) * _ENTRY.size + _CRC.size
    header = _HEAD.pack(MAGIC, MAJOR, MINOR, len(contents))
    for tag, data in contents.items():
        crc = _codec.crc32c(data)
        header += _ENTRY.pack(tag.encode("ascii"), REQUIRED, offset, len(data), crc, 0)
        offset += len(data)
    return b"".join([header, _CRC.pack(_codec.crc32c(header)), *contents.values()])


def read_container(data: bytes, splats: bool = False) -> tuple[Table, dict[str, Section]]:
    """The table of a whole file and its known sections, every section's checksum verified.

    The file must hold a scene, or ``splats``.

    Raises:
        CodecError: not a .clgs file, of an unknown version, cut, or damaged.
    """
    source = BytesSource(data)
    table = read_table(source, splats)
    sections = {tag: read_section(source, entry) for tag, entry in table.entries.items()}
    return table, {tag: sections[tag] for tag in (SPLATS if splats else SCENE)}


def read_section(source: Source, entry: Entry) -> Section:
    """The content of one section, its checksum verified.

    Raises:
        CodecError: the section is damaged.
    """
    section = Section(entry.tag, entry.offset, source.read(entry.offset, entry.length))
    if _codec.crc32c(section.data) != entry.crc:
        raise section.error("checksum differs")
    return section


def read_table(source: Source, splats: bool = False) -> Table:
    """The section table, after all checks but the checksums of the sections themselves.

    The file must hold a scene, or ``splats``.

    Raises:
        CodecError: not a .clgs file, of an unknown version, cut, or damaged.
    """
    head = bytes(source.read(0, min(_HEAD.size, source.size)))
    minor, count = _check_head(head, source.size)
    table_end = _HEAD.size + count * _ENTRY.size
    header = head + source.read(_HEAD.size, count * _ENTRY.size + _CRC.size)
    if _codec.crc32c(header[:table_end]) != _CRC.unpack_from(header, table_end)[0]:
        raise damage(f"header at byte {table_end}", "checksum differs")
    known = _known_tags(header[_HEAD.size : _HEAD.size + 4], splats)
    entries: dict[str, Entry] = {}
    end = table_end + _CRC.size
    for at in range(_HEAD.size, table_end, _ENTRY.size):
        entry = _check_entry(at, _ENTRY.unpack_from(header, at), known, entries)
        if entry.offset != end or entry.length > source.size - end:
            where = f"section {entry.tag} at byte {entry.offset}"
            raise damage(where, f"{entry.length} bytes do not fit the file")
        end += entry.length
    if end != source.size:
        raise damage(f"file at byte {end}", f"{source.size - end} bytes follow the last section")
    _check_order(list(entries), known)
    return Table(f"{MAJOR}.{minor}", entries)


def _known_tags(first: bytes, splats: bool) -> tuple[str, ...]:
    """The required sections of a file whose table begins with tag ``first``."""
    holds_splats = first == SPLT.encode("ascii")
    if holds_splats and not splats:
        raise CodecError("section table at byte 16: the file holds splats; use `clgs unpack`")
    if splats and not holds_splats:
        raise CodecError("section table at byte 16: the file holds a scene; use `clgs decode`")
    return SPLATS if splats else SCENE


def _check_entry(
    at: int, fields: tuple[bytes, int, int, int, int, int], known: tuple[str, ...],
    entries: dict[str, Entry],
) -> Entry:  # fmt: skip
    """The entry at byte ``at``, added to ``entries``; refused if it is required and unknown."""
    raw_tag, flags, offset, length, crc, reserved = fields
    tag = raw_tag.decode("ascii", "replace")
    malformed = not raw_tag.isalpha() or reserved != 0 or flags > REQUIRED
    if malformed or tag in entries or (tag in known and flags != REQUIRED):
        raise damage(f"section table at byte {at}", f"entry {tag!r} is repeated or malformed")
    if flags == REQUIRED and tag not in known:
        raise CodecError(f"section {tag} at byte {offset}: unknown; update clgs")
    entries[tag] = Entry(tag, offset, length, crc)
    return entries[tag]


def _check_order(tags: list[str], known: tuple[str, ...]) -> None:
    for tag in known:
        if tag not in tags:
            raise damage("section table at byte 16", f"section {tag} is missing")
    if [tag for tag in tags if tag in known] != list(known):
        raise damage("section table at byte 16", f"order is {' '.join(tags)}")


def _check_head(head: bytes, size: int) -> tuple[int, int]:
    """Minor version and number of sections, after the checks of signature, version and size."""
    if head[: len(MAGIC)] != MAGIC:
        raise _signature_error(head)
    if len(head) < _HEAD.size:
        raise damage("header at byte 0", f"{len(head)} bytes are too few")
    _, major, minor, count = _HEAD.unpack(head)
    if major != MAJOR:
        problem = f"version {major}.{minor}, this clgs reads {MAJOR}.x"
        raise CodecError(f"header at byte 8: {problem}; update clgs, or encode the scene again")
    if count > MAX_SECTIONS:
        raise damage("header at byte 12", f"{count} sections, at most {MAX_SECTIONS} are allowed")
    if count * _ENTRY.size + _CRC.size > size - _HEAD.size:
        raise damage("section table at byte 16", "the file ends in it")
    return minor, count


def _signature_error(head: bytes) -> CodecError:
    if not head:
        return CodecError("header at byte 0: the file is empty; encode the scene again")
    if head[:5] == MAGIC[:5]:
        return CodecError(
            "header at byte 5: line ends were changed or the file is cut; transfer it as binary"
        )
    return CodecError("header at byte 0: not a .clgs file; make one with `clgs encode`")
