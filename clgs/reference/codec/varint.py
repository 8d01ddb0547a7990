"""Integers of variable length (FORMAT.md): zigzag, in groups of 7 bits, lowest first."""

from __future__ import annotations


def varint(value: int) -> bytes:
    """The bytes of ``value``; the top bit of each says that more follow."""
    zigzag = 2 * value if value >= 0 else -2 * value - 1
    out = bytearray()
    while zigzag >= 128:
        out.append(zigzag & 127 | 128)
        zigzag >>= 7
    return bytes([*out, zigzag])


def read_varint(data: bytes, at: int) -> tuple[int, int]:
    """The integer at ``at``, and where the next one starts."""
    zigzag, shift = 0, 0
    while True:
        byte = data[at]
        zigzag |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return (zigzag >> 1) ^ -(zigzag & 1), at
