"""The .clgs container: where its bytes come from, signature, section table, checksums.

The format is in part 2 of codec_c/FORMAT.md.
"""

from __future__ import annotations

import struct
import threading
from dataclasses import dataclass
from io import RawIOBase
from typing import Protocol

from clgs import _codec
from clgs.errors import CodecError

MAGIC = b"\x8bCLGS\r\n\x1a"
"""0x8B is in no text; the line ends and DOS's end of file expose transfers that alter them."""

META, CHNK, ANCH, OFFS, FEAT, SCAL, MLPS = "META", "CHNK", "ANCH", "OFFS", "FEAT", "SCAL", "MLPS"

SCENE = (META, CHNK, ANCH, OFFS, FEAT, SCAL, MLPS)
"""The required sections of a file that holds a scene, in file order."""

GEOR, PHOT = "GEOR", "PHOT"
OPTIONAL = (GEOR, PHOT)
"""Sections that a file of a scene may have after the required ones; a reader may skip them."""

LAYR, DETL, BODY = "LAYR", "DETL", "BODY"
"""Sections that a file in layers has after all others: its layers, what the last one adds to all
anchors if it is one of details, and the bytes of all chunks."""

SPLT, SPOS, SMUL, SATR = "SPLT", "SPOS", "SMUL", "SATR"
SPLATS = (SPLT, SPOS, SMUL, SATR)
"""The required sections of a file that holds splats in place of a scene."""

MAJOR = 1
MINOR_WITH = {GEOR: 1, LAYR: 2, PHOT: 3, DETL: 4}
"""The version that is written is 1.0, or the highest 1.n of its sections; any 1.n is read."""

REQUIRED = 1
"""Flag of a section that a reader must understand."""

MAX_SECTIONS = 64

MAX_SIZE = 1 << 40
"""Bytes of a file, at most, if a reader has only its beginning."""

_HEAD = struct.Struct("<8sHHI")
_ENTRY = struct.Struct("<4sIQQII")
_CRC = struct.Struct("<I")

_REMEDY = "the file is damaged; copy or encode it again"


class RandomAccess(Protocol):
    """The bytes of a file, ``size`` of them, of which any part can be read."""

    size: int

    def read(self, offset: int, length: int) -> memoryview:
        """``length`` bytes from ``offset`` on; the caller has checked them against ``size``."""
        ...


class BytesSource:
    """Bytes in memory."""

    def __init__(self, data: bytes) -> None:
        self._data = memoryview(data)
        self.size = len(data)

    def read(self, offset: int, length: int) -> memoryview:
        """A view, nothing copied."""
        return self._data[offset : offset + length]


class FileSource:
    """An open file that can seek, without a buffer; threads may share it.

    ``bytes_read`` counts what was read.
    """

    def __init__(self, file: RawIOBase) -> None:
        self._file = file
        self._turn = threading.Lock()
        self.size = file.seek(0, 2)
        self.bytes_read = 0

    def read(self, offset: int, length: int) -> memoryview:
        """The bytes, read from the file.

        Raises:
            CodecError: the file has become shorter since it was opened.
        """
        data = memoryview(bytearray(length))
        with self._turn:
            self._file.seek(offset)
            done = 0
            while done < length and (count := self._file.readinto(data[done:])):
                done += count
            self.bytes_read += done
        if done < length:
            raise CodecError(f"file at byte {offset + done}: it was cut while it was read")
        return data


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
class SectionEntry:
    """One row of the section table; ``crc`` is that of the section's bytes."""

    tag: str
    offset: int
    length: int
    crc: int


@dataclass(frozen=True)
class SectionTable:
    """The version of a file, such as "1.0", and its sections by tag, unknown ones included.

    ``size``: bytes of the whole file, more than there are if it is cut within BODY.
    """

    version: str
    entries: dict[str, SectionEntry]
    size: int


def damage(where: str, what: str) -> CodecError:
    """A CodecError for a damaged file."""
    return CodecError(f"{where}: {what}; {_REMEDY}")


def write_container(contents: dict[str, bytes]) -> bytes:
    """The file that holds ``contents``, tag to bytes, in this order."""
    minor = max(MINOR_WITH.get(tag, 0) for tag in contents)
    offset = _HEAD.size + len(contents) * _ENTRY.size + _CRC.size
    header = _HEAD.pack(MAGIC, MAJOR, minor, len(contents))
    for tag, data in contents.items():
        crc = _codec.crc32c(data)
        flags = 0 if tag in OPTIONAL else REQUIRED
        header += _ENTRY.pack(tag.encode("ascii"), flags, offset, len(data), crc, 0)
        offset += len(data)
    return b"".join([header, _CRC.pack(_codec.crc32c(header)), *contents.values()])


def read_container(data: bytes, splats: bool = False) -> tuple[SectionTable, dict[str, Section]]:
    """The table of a whole file and its known sections, every section's checksum verified.

    The file must hold a scene, or ``splats``. If it is cut within BODY, that section is left out.

    Raises:
        CodecError: not a .clgs file, of an unknown version, cut, or damaged.
    """
    source = BytesSource(data)
    table = read_table(source, splats)
    sections = {
        tag: read_section(source, entry)
        for tag, entry in table.entries.items()
        if entry.offset + entry.length <= source.size
    }
    known = SPLATS if splats else (*SCENE, *OPTIONAL, LAYR, DETL, BODY)
    return table, {tag: sections[tag] for tag in known if tag in sections}


def read_section(source: RandomAccess, entry: SectionEntry) -> Section:
    """The content of one section, its checksum verified; CodecError if the section is damaged."""
    section = Section(entry.tag, entry.offset, source.read(entry.offset, entry.length))
    if _codec.crc32c(section.data) != entry.crc:
        raise section.error("checksum differs")
    return section


def read_table(source: RandomAccess, splats: bool = False) -> SectionTable:
    """The section table, after all checks but the checksums of the sections themselves.

    The file must hold a scene, or ``splats``. It may be cut within BODY.

    Raises:
        CodecError: not a .clgs file, of an unknown version, cut, or damaged.
    """
    head = bytes(source.read(0, min(_HEAD.size, source.size)))
    minor, count = _check_head(head, source.size)
    table_end = _HEAD.size + count * _ENTRY.size
    header = head + source.read(_HEAD.size, count * _ENTRY.size + _CRC.size)
    if _codec.crc32c(header[:table_end]) != _CRC.unpack_from(header, table_end)[0]:
        raise damage(f"header at byte {table_end}", "checksum differs")
    if (header[_HEAD.size : _HEAD.size + 4] == SPLT.encode("ascii")) != splats:
        what = "a scene; use `clgs decode`" if splats else "splats; use `clgs unpack`"
        raise CodecError(f"section table at byte 16: the file holds {what}")
    known = SPLATS if splats else SCENE
    entries: dict[str, SectionEntry] = {}
    end = table_end + _CRC.size
    for at in range(_HEAD.size, table_end, _ENTRY.size):
        entry = _add_entry(entries, at, _ENTRY.unpack_from(header, at), known, splats)
        may_be_cut = not splats and entry.tag == BODY and at == table_end - _ENTRY.size
        fits = entry.length <= (MAX_SIZE if may_be_cut else source.size) - end
        if entry.offset != end or end > source.size or not fits:
            where = f"section {entry.tag} at byte {entry.offset}"
            raise damage(where, f"{entry.length} bytes do not fit the file")
        end += entry.length
    if end < source.size:
        raise damage(f"file at byte {end}", f"{source.size - end} bytes follow the last section")
    if missing := [tag for tag in known if tag not in entries]:
        raise damage("section table at byte 16", f"section {missing[0]} is missing")
    if [tag for tag in entries if tag in known] != list(known):
        raise damage("section table at byte 16", f"order is {' '.join(entries)}")
    layered = [tag for tag in (LAYR, DETL, BODY) if tag in entries]
    complete = not layered or {LAYR, BODY} <= set(layered)
    if not splats and not (complete and [*entries][len(entries) - len(layered) :] == layered):
        raise damage("section table at byte 16", "LAYR and BODY are not the last sections")
    return SectionTable(f"{MAJOR}.{minor}", entries, end)


def _add_entry(
    entries: dict[str, SectionEntry],
    at: int,
    fields: tuple[bytes, int, int, int, int, int],
    known: tuple[str, ...],
    splats: bool,
) -> SectionEntry:
    """The entry at byte ``at``, which is added to ``entries`` unless it must be refused."""
    raw_tag, flags, offset, length, crc, reserved = fields
    tag = raw_tag.decode("ascii", "replace")
    known = known if splats else (*known, LAYR, DETL, BODY)
    malformed = not raw_tag.isalpha() or reserved != 0 or flags > REQUIRED
    if malformed or tag in entries or (tag in known and flags != REQUIRED):
        raise damage(f"section table at byte {at}", f"entry {tag!r} is repeated or malformed")
    if flags == REQUIRED and tag not in known:
        raise CodecError(f"section {tag} at byte {offset}: unknown; update clgs")
    entries[tag] = SectionEntry(tag, offset, length, crc)
    return entries[tag]


_OTHER_FILES = {
    b"ply": "a .ply file",
    b"\x1f\x8b": "a .spz file",
    b"NGSP": "a .spz file",
    b"PK\3\4": "a .sog or .npz file",
}


def _check_head(head: bytes, size: int) -> tuple[int, int]:
    """Minor version and number of sections, after the checks of signature, version and size."""
    if not head:
        raise CodecError("header at byte 0: the file is empty; encode the scene again")
    if head[:5] != MAGIC[:5]:
        remedy = "make one with `clgs train` or `clgs pack`"
        for beginning, kind in _OTHER_FILES.items():
            if head.startswith(beginning):
                remedy += f"; it begins as {kind} does"
        raise CodecError(f"header at byte 0: not a .clgs file; {remedy}")
    if head[: len(MAGIC)] != MAGIC:
        raise CodecError(
            "header at byte 5: line ends were changed or the file is cut; transfer it as binary"
        )
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
