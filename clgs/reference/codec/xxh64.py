"""XXH64 with seed 0, for reading (FORMAT.md on META); same values as the C function."""

from __future__ import annotations

MASK = (1 << 64) - 1
PRIME1, PRIME2 = 0x9E3779B185EBCA87, 0xC2B2AE3D27D4EB4F
PRIME3, PRIME4, PRIME5 = 0x165667B19E3779F9, 0x85EBCA77C2B2AE63, 0x27D4EB2F165667C5


def xxh64(data: bytes) -> int:
    """The hash of ``data``, 64 bits."""
    at = len(data) // 32 * 32
    value = (_stripes(data[:at]) if at else PRIME5) + len(data) & MASK
    while len(data) - at >= 8:
        value = _rotate(value ^ _lane(0, _word(data, at, 8)), 27) * PRIME1 + PRIME4 & MASK
        at += 8
    if len(data) - at >= 4:
        value = _rotate(value ^ _word(data, at, 4) * PRIME1 & MASK, 23) * PRIME2 + PRIME3 & MASK
        at += 4
    for byte in data[at:]:
        value = _rotate(value ^ byte * PRIME5 & MASK, 11) * PRIME1 & MASK
    value = (value ^ value >> 33) * PRIME2 & MASK
    value = (value ^ value >> 29) * PRIME3 & MASK
    return value ^ value >> 32


def _stripes(data: bytes) -> int:
    """Four lanes over stripes of 32 bytes, then the lanes together."""
    lanes = [PRIME1 + PRIME2 & MASK, PRIME2, 0, -PRIME1 & MASK]
    for at in range(0, len(data), 8):
        lanes[at // 8 % 4] = _lane(lanes[at // 8 % 4], _word(data, at, 8))
    value = sum(map(_rotate, lanes, (1, 7, 12, 18))) & MASK
    for lane in lanes:
        value = (value ^ _lane(0, lane)) * PRIME1 + PRIME4 & MASK
    return value


def _lane(lane: int, word: int) -> int:
    return _rotate(lane + word * PRIME2 & MASK, 31) * PRIME1 & MASK


def _rotate(value: int, bits: int) -> int:
    return (value << bits | value >> 64 - bits) & MASK


def _word(data: bytes, at: int, size: int) -> int:
    return int.from_bytes(data[at : at + size], "little")
