"""Files with some of their bytes changed and every checksum made right."""

from __future__ import annotations

import struct

import numpy as np

from clgs import _codec
from clgs.codec import chunks, container

ENTRY, HEAD = 32, 16


def contents(data: bytes) -> dict[str, bytes]:
    """The known sections of a file."""
    return {tag: bytes(s.data) for tag, s in container.read_container(data)[1].items()}


def major(data: bytes) -> int:
    return int.from_bytes(data[8:10], "little")


def rebuilt(data: bytes, **changed: bytes) -> bytes:
    """The file with sections replaced, and every checksum made right, those of chunks too."""
    sections = {**contents(data), **changed}
    if "CHNK" in sections and "CHNK" not in changed:
        sections["CHNK"] = checked(sections)
    return container.write_container(sections, major(data))


def checked(sections: dict[str, bytes]) -> bytes:
    """CHNK with the checksums of what lies at its chunks' places now."""
    rows = np.frombuffer(sections["CHNK"][36:], chunks._ROW).copy()
    head = list(struct.unpack_from("<9I", sections["CHNK"]))
    for column, tag in enumerate(chunks.TAGS):
        section, at = sections[tag], head[1 + 2 * column]
        head[2 + 2 * column] = _codec.crc32c(section[:at])
        for row in rows:
            end = at + int(row["length"][column])
            row["crc"][column] = _codec.crc32c(section[at:end])
            at = end
    return struct.pack("<9I", *head) + rows.tobytes()


def patched(data: bytes, at: int, new: bytes) -> bytes:
    """The file with bytes of its header replaced and the header's checksum made right."""
    file = bytearray(data)
    file[at : at + len(new)] = new
    end = HEAD + ENTRY * int.from_bytes(data[12:16], "little")
    file[end : end + 4] = struct.pack("<I", _codec.crc32c(bytes(file[:end])))
    return bytes(file)


def resized(data: bytes, tag: str, column: int, by: int) -> bytes:
    """CHNK of the file, the first chunk of section ``tag`` declared longer ``by`` bytes."""
    section = contents(data)["CHNK"]
    rows = np.frombuffer(section[36:], chunks._ROW).copy()
    rows[0]["length"][column] += by
    return section[:36] + rows.tobytes()
