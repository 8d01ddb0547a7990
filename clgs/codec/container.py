"""The .clgs container: signature, section table, checksums (codec_c/FORMAT.md, part 1)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from clgs import _codec
from clgs.errors import CodecError

MAGIC = b"\x8bCLGS\r\n\x1a"
"""Not text (0x8B); the line ends and the DOS end-of-file expose transfers that alter them."""

MAJOR, MINOR = 1, 0

META, ANCH, OFFS, FEAT, SCAL, MLPS = "META", "ANCH", "OFFS", "FEAT", "SCAL", "MLPS"
SECTIONS = (META, ANCH, OFFS, FEAT, SCAL, MLPS)
"""The required sections, in file order."""

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


def read_container(data: bytes) -> dict[str, Section]:
    """The sections of a file by tag, every checksum verified; unknown optional ones left out.

    Raises:
        CodecError: not a .clgs file, of an unknown version, cut, or damaged.
    """
    sections = {}
    for tag, flags, section, crc in _read_table(data):
        if _codec.crc32c(section.data) != crc:
            raise section.error("checksum differs")
        if tag in SECTIONS:
            sections[tag] = section
        elif flags & REQUIRED:
            raise CodecError(f"section {tag} at byte {section.offset}: unknown; update clgs")
    for tag in SECTIONS:
        if tag not in sections:
            raise damage(f"section {tag}", "missing")
    return sections


def _read_table(data: bytes) -> list[tuple[str, int, Section, int]]:
    """(tag, flags, section, crc) of every entry, after all checks but the sections' own CRC."""
    table_end = _HEAD.size + _count_sections(data) * _ENTRY.size
    (crc,) = _CRC.unpack_from(data, table_end)
    if _codec.crc32c(memoryview(data)[:table_end]) != crc:
        raise damage(f"header at byte {table_end}", "checksum differs")
    entries: list[tuple[str, int, Section, int]] = []
    end = table_end + _CRC.size
    for at in range(_HEAD.size, table_end, _ENTRY.size):
        raw_tag, flags, offset, length, crc, reserved = _ENTRY.unpack_from(data, at)
        tag = raw_tag.decode("ascii", "replace")
        if any(tag == entry[0] for entry in entries) or reserved != 0 or flags > REQUIRED:
            raise damage(f"section table at byte {at}", f"entry {tag!r} is repeated or malformed")
        if offset != end or length > len(data) - end:
            raise damage(f"section {tag} at byte {offset}", f"{length} bytes do not fit the file")
        end += length
        entries.append((tag, flags, Section(tag, offset, memoryview(data)[offset:end]), crc))
    if end != len(data):
        raise damage(f"file at byte {end}", f"{len(data) - end} bytes follow the last section")
    _check_order([entry[0] for entry in entries])
    return entries


def _check_order(tags: list[str]) -> None:
    known = [tag for tag in tags if tag in SECTIONS]
    if known != [tag for tag in SECTIONS if tag in known]:
        raise damage("section table at byte 16", f"order is {' '.join(known)}")


def _count_sections(data: bytes) -> int:
    """The declared number of sections, after the checks of signature, version and size."""
    if data[: len(MAGIC)] != MAGIC:
        raise _signature_error(data)
    if len(data) < _HEAD.size:
        raise damage("header at byte 0", f"{len(data)} bytes are too few")
    _, major, _, count = _HEAD.unpack_from(data)
    if major != MAJOR:
        raise CodecError(f"header at byte 8: version {major}, known is {MAJOR}; update clgs")
    if count > MAX_SECTIONS:
        raise damage("header at byte 12", f"{count} sections, at most {MAX_SECTIONS} are allowed")
    if count * _ENTRY.size + _CRC.size > len(data) - _HEAD.size:
        raise damage("section table at byte 16", "the file ends in it")
    return int(count)


def _signature_error(data: bytes) -> CodecError:
    if not data:
        return CodecError("header at byte 0: the file is empty; encode the scene again")
    if data[:5] == MAGIC[:5]:
        return CodecError(
            "header at byte 5: line ends were changed or the file is cut; transfer it as binary"
        )
    return CodecError("header at byte 0: not a .clgs file; make one with `clgs encode`")
