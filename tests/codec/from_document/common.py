"""Notation of part 1, checksums of parts 2 and 3, and a careful reader of bytes."""

from __future__ import annotations

import struct

INT32_MIN = -(2**31)
INT32_MAX = 2**31 - 1
MASK64 = 2**64 - 1

P1 = 0x9E3779B185EBCA87
P2 = 0xC2B2AE3D27D4EB4F
P3 = 0x165667B19E3779F9
P4 = 0x85EBCA77C2B2AE63
P5 = 0x27D4EB2F165667C5


def check(condition: bool, message: str) -> None:
    """Refuse the file with `message` unless the condition holds."""
    if not condition:
        raise ValueError(message)


def clamp(x: int, low: int, high: int) -> int:
    """The number of [low, high] next to x."""
    return low if x < low else high if x > high else x


def wrap(x: int) -> int:
    """x modulo 2^32 as an int32."""
    return ((x + 2**31) & 0xFFFFFFFF) - 2**31


def in_int32(x: int) -> bool:
    """Does x fit an int32?"""
    return INT32_MIN <= x <= INT32_MAX


def zigzag(x: int) -> int:
    """0, -1, 1, -2 ... become 0, 1, 2, 3 ..."""
    return 2 * x if x >= 0 else -2 * x - 1


def unzigzag(z: int) -> int:
    """The inverse of zigzag."""
    return -((z + 1) >> 1) if z & 1 else z >> 1


def morton_code(x: int, y: int, z: int) -> int:
    """Bit b of x at place 3 b + 2, of y at 3 b + 1, of z at 3 b."""
    code = 0
    for b in range(max(x, y, z).bit_length()):
        code |= (x >> b & 1) << 3 * b + 2 | (y >> b & 1) << 3 * b + 1 | (z >> b & 1) << 3 * b
    return code


def morton_cell(code: int) -> tuple[int, int, int]:
    """The cell (x, y, z) of a Morton code."""
    x = y = z = 0
    for b in range((code.bit_length() + 2) // 3):
        x |= (code >> 3 * b + 2 & 1) << b
        y |= (code >> 3 * b + 1 & 1) << b
        z |= (code >> 3 * b & 1) << b
    return x, y, z


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ 0x82F63B78 if crc & 1 else crc >> 1
        table.append(crc)
    return table


CRC_TABLE = _crc_table()


def crc32c(data: bytes) -> int:
    """CRC-32C (part 2)."""
    crc = 0xFFFFFFFF
    table = CRC_TABLE
    for byte in data:
        crc = crc >> 8 ^ table[(crc ^ byte) & 255]
    return crc ^ 0xFFFFFFFF


def _rotl(x: int, r: int) -> int:
    return (x << r | x >> 64 - r) & MASK64


def _round(v: int, w: int) -> int:
    return _rotl((v + w * P2) & MASK64, 31) * P1 & MASK64


def xxh64(data: bytes) -> int:
    """XXH64 with seed 0 (part 3)."""
    h = P5
    at = 0
    if len(data) >= 32:
        a, b, c, d = (P1 + P2) & MASK64, P2, 0, -P1 & MASK64
        at = len(data) // 32 * 32
        for w0, w1, w2, w3 in struct.iter_unpack("<4Q", data[:at]):
            a, b, c, d = _round(a, w0), _round(b, w1), _round(c, w2), _round(d, w3)
        h = (_rotl(a, 1) + _rotl(b, 7) + _rotl(c, 12) + _rotl(d, 18)) & MASK64
        for v in (a, b, c, d):
            h = ((h ^ _round(0, v)) * P1 + P4) & MASK64
    h = (h + len(data)) & MASK64
    while at + 8 <= len(data):
        (w,) = struct.unpack_from("<Q", data, at)
        h = (_rotl(h ^ _round(0, w), 27) * P1 + P4) & MASK64
        at += 8
    if at + 4 <= len(data):
        (w,) = struct.unpack_from("<I", data, at)
        h = (_rotl(h ^ (w * P1 & MASK64), 23) * P2 + P3) & MASK64
        at += 4
    for byte in data[at:]:
        h = _rotl(h ^ (byte * P5 & MASK64), 11) * P1 & MASK64
    h = (h ^ h >> 33) * P2 & MASK64
    h = (h ^ h >> 29) * P3 & MASK64
    return h ^ h >> 32


class ByteReader:
    """Takes fields from bytes, and refuses to read past their end."""

    def __init__(self, data: bytes, what: str) -> None:
        self.data = data
        self.what = what
        self.at = 0

    @property
    def left(self) -> int:
        """Number of bytes not yet taken."""
        return len(self.data) - self.at

    def take(self, count: int) -> bytes:
        """The next `count` bytes."""
        check(0 <= count <= self.left, f"{self.what}: {count} bytes wanted, {self.left} left")
        self.at += count
        return self.data[self.at - count : self.at]

    def rest(self) -> bytes:
        """All that is left."""
        return self.take(self.left)

    def fields(self, layout: str) -> tuple:
        """Fields of a struct layout, little-endian and without gaps."""
        return struct.unpack("<" + layout, self.take(struct.calcsize("<" + layout)))

    def number(self, layout: str) -> int:
        """One field of a struct layout."""
        return int(self.fields(layout)[0])

    def varint(self, shortest: bool = False) -> int:
        """A zigzag varint (1.1); `shortest`: a needless last byte 00 is refused."""
        z = 0
        for place in range(5):
            check(self.left > 0, f"{self.what}: varint cut")
            byte = self.number("B")
            z |= (byte & 127) << 7 * place
            if byte < 128:
                check(z < 2**32, f"{self.what}: varint of 2^32 or more")
                needless = byte == 0 and place > 0
                check(not (shortest and needless), f"{self.what}: varint longer than need be")
                return unzigzag(z)
        raise ValueError(f"{self.what}: varint of more than 5 bytes")

    def finish(self) -> None:
        """Refuse bytes that are left over."""
        check(self.left == 0, f"{self.what}: {self.left} bytes left over")
