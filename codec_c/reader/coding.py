"""Numbers, checksums and entropy coding: parts 1 to 4 of FORMAT.md, and the coder of 6.1."""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable
from operator import mul

MASK64 = 2**64 - 1
P1, P2 = 0x9E3779B185EBCA87, 0xC2B2AE3D27D4EB4F
P3, P4, P5 = 0x165667B19E3779F9, 0x85EBCA77C2B2AE63, 0x27D4EB2F165667C5

KNOT = [
    1, 1, 1, 1, 1, 1, 2, 2, 3, 4, 5, 6, 8, 10, 13, 17, 22, 28, 36, 47, 60, 77, 98, 126, 162,
    208, 267, 342, 439, 562, 720, 922, 1179, 1506, 1921, 2446, 3108, 3938, 4971, 6249, 7812,
    9702, 11955, 14595, 17625, 21025, 24743, 28693, 32768, 36843, 40793, 44511, 47911, 50941,
    53581, 55834, 57724, 59287, 60565, 61598, 62428, 63090, 63615, 64030, 64357, 64614, 64816,
    64974, 65097, 65194, 65269, 65328, 65374, 65410, 65438, 65459, 65476, 65489, 65500, 65508,
    65514, 65519, 65523, 65526, 65528, 65530, 65531, 65532, 65533, 65534, 65534, 65535, 65535,
    65535, 65535, 65535, 65535,
]  # fmt: skip
SQUASH = [  # the index is the log odds + 1536
    (KNOT[u // 32] * (32 - u % 32) + KNOT[u // 32 + 1] * (u % 32)) // 32 for u in range(3072)
]
STRETCH = [bisect_left(SQUASH, 16 * c + 8) - 1536 for c in range(4096)]
RATE = [655360 // (10 * n + 16) for n in range(1001)]

FIRST = (0, 0, 16, 17, 20, 27, 42, 73, 88) + 24 * (103,)  # 4.6; the index is b
MODELLED = (0, 0, 1, 2, 3, 4, 5, 4, 4) + 24 * (3,)  # d of 4.6; the index is b
LEVEL = [0, 1, 2, 3, 3, 4, 4, 4, 4] + 8 * [5] + 16 * [6] + [7]
SMALL = [0, 1, 1, 2, 2, 2, 2, 2, 2, 3]


def check(condition: bool, message: str) -> None:
    """Refuse the file with a ValueError unless the condition holds."""
    if not condition:
        raise ValueError(message)


def clamp(x: int, low: int, high: int) -> int:
    """The number of [low, high] that is nearest to x."""
    return low if x < low else high if x > high else x


def wrap(x: int) -> int:
    """x modulo 2^32 as an int32."""
    return ((x + 2**31) & 0xFFFFFFFF) - 2**31


def in_int32(x: int) -> bool:
    """Whether x fits an int32."""
    return -(2**31) <= x < 2**31


def zigzag(x: int) -> int:
    """0, -1, 1, -2 ... become 0, 1, 2, 3 ..."""
    return 2 * x if x >= 0 else -2 * x - 1


def unzigzag(z: int) -> int:
    """The inverse of zigzag."""
    return -((z + 1) >> 1) if z & 1 else z >> 1


def level(v: int) -> int:
    """Class of a number by its magnitude and sign (end of 4.6)."""
    return LEVEL[min(v, 33)] if v >= 0 else 8 + LEVEL[min(-v, 33)]


def small(v: int) -> int:
    """Class of a number by its magnitude (end of 4.6)."""
    return SMALL[min(abs(v), 9)]


def morton_code(x: int, y: int, z: int) -> int:
    """Bit b of x goes to place 3 b + 2, of y to 3 b + 1, of z to 3 b."""
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


def _crc_of_byte(crc: int) -> int:
    for _ in range(8):
        crc = crc >> 1 ^ 0x82F63B78 if crc & 1 else crc >> 1
    return crc


CRC_TABLE = [_crc_of_byte(byte) for byte in range(256)]


def crc32c(data: bytes) -> int:
    """CRC-32C (part 2)."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc = crc >> 8 ^ CRC_TABLE[(crc ^ byte) & 255]
    return crc ^ 0xFFFFFFFF


def _rotl(x: int, r: int) -> int:
    return (x << r | x >> 64 - r) & MASK64


def _round(v: int, w: int) -> int:
    return _rotl((v + w * P2) & MASK64, 31) * P1 & MASK64


def xxh64(data: bytes) -> int:
    """XXH64 with seed 0 (part 3)."""
    h, at = P5, len(data) // 32 * 32
    if at:
        lanes = [(P1 + P2) & MASK64, P2, 0, -P1 & MASK64]
        for words in struct.iter_unpack("<4Q", data[:at]):
            lanes = [_round(v, w) for v, w in zip(lanes, words, strict=True)]
        h = sum(map(_rotl, lanes, (1, 7, 12, 18))) & MASK64
        for v in lanes:
            h = ((h ^ _round(0, v)) * P1 + P4) & MASK64
    h = (h + len(data)) & MASK64
    while at + 8 <= len(data):
        w = int.from_bytes(data[at : at + 8], "little")
        h = (_rotl(h ^ _round(0, w), 27) * P1 + P4) & MASK64
        at += 8
    if at + 4 <= len(data):
        w = int.from_bytes(data[at : at + 4], "little")
        h = (_rotl(h ^ (w * P1 & MASK64), 23) * P2 + P3) & MASK64
        at += 4
    for byte in data[at:]:
        h = _rotl(h ^ (byte * P5 & MASK64), 11) * P1 & MASK64
    h = (h ^ h >> 33) * P2 & MASK64
    h = (h ^ h >> 29) * P3 & MASK64
    return h ^ h >> 32


class ByteReader:
    """Takes fields from bytes, and refuses to read past their end."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0

    @property
    def left(self) -> int:
        """How many bytes are not yet taken."""
        return len(self.data) - self.at

    def take(self, count: int) -> bytes:
        """The next `count` bytes."""
        check(0 <= count <= self.left, f"{count} bytes are needed, {self.left} are left")
        self.at += count
        return self.data[self.at - count : self.at]

    def rest(self) -> bytes:
        """All bytes that are left."""
        return self.take(self.left)

    def fields(self, layout: str) -> tuple:
        """Fields of a struct layout, little-endian and without gaps."""
        return struct.unpack("<" + layout, self.take(struct.calcsize("<" + layout)))

    def varint(self, shortest: bool = False) -> int:
        """A zigzag varint (1.1); `shortest` refuses a needless last byte 00."""
        z = 0
        for place in range(5):
            (byte,) = self.fields("B")
            z |= (byte & 127) << 7 * place
            if byte < 128:
                check(z < 2**32, "a varint of 2^32 or more")
                check(not (shortest and byte == 0 and place > 0), "a varint with a needless byte")
                return unzigzag(z)
        raise ValueError("a varint of more than 5 bytes")

    def finish(self) -> None:
        """Refuse bytes that are left over."""
        check(self.left == 0, f"{self.left} bytes are left over")


class RangeDecoder:
    """The range decoder of 4.1: 32 bits wide, and moves by 8."""

    def __init__(self, data: bytes) -> None:
        check(len(data) > 0, "a stream is cut")
        self.size = len(data)
        self.data = data + bytes(16)
        self.start()

    def start(self) -> None:
        """Read the first bytes."""
        self.range, self.at = 2**32 - 1, 4
        self.offset = int.from_bytes(self.data[:4], "big")

    def decode(self, p: int) -> int:
        """One decision that is 1 with probability p / 65536."""
        bound = (self.range >> 16) * p
        bit = int(self.offset < bound)
        if bit:
            self.range = bound
        else:
            self.offset -= bound
            self.range -= bound
        self.move()
        return bit

    def move(self) -> None:
        """Read on while the interval is narrow."""
        while self.range < 1 << 24:
            check(self.at < self.size + 3, "a stream is cut")
            self.range <<= 8
            self.offset = (self.offset << 8 | self.data[self.at]) & 0xFFFFFFFF
            self.at += 1

    def raw(self, count: int = 1) -> int:
        """A number of `count` raw bits, highest first."""
        value = 0
        for _ in range(count):
            value = value << 1 | self.decode(32768)
        return value

    def finish(self) -> None:
        """After the last decision, exactly three bytes must have been read past the end."""
        check(self.at == self.size + 3, "bytes follow the last decision")


class WideRangeDecoder(RangeDecoder):
    """The range decoder of 6.1: 64 bits wide, and moves by 32."""

    def start(self) -> None:
        """Read the first bytes; a stream may be empty of all but the last one."""
        self.range, self.at = MASK64, 8
        self.offset = int.from_bytes(self.data[:8], "big")

    def move(self) -> None:
        """Read on if the interval is narrow."""
        if self.range < 1 << 32:
            check(self.at + 4 <= self.size + 7, "a stream is cut")
            self.range <<= 32
            word = int.from_bytes(self.data[self.at : self.at + 4], "big")
            self.offset = (self.offset << 32 | word) & MASK64
            self.at += 4

    def plain(self, count: int) -> int:
        """A number of `count` plain bits, at most 16 at a time."""
        value = 0
        while count > 0:
            k = min(count, 16)
            self.range >>= k
            v = self.offset // self.range
            check(v < 1 << k, f"plain bits of 2^{k} or more")
            self.offset -= self.range * v
            self.move()
            value = value << k | v
            count -= k
        return value

    def finish(self) -> None:
        """The length must be the one that follows from the moves and the range."""
        extra = 0
        while self.range << 8 * extra < 1 << 56:
            extra += 1
        check(self.size == self.at - 7 + extra, "the stream does not end after its last decision")


class State:
    """An adaptive probability (4.2)."""

    __slots__ = ("limit", "n", "p")

    def __init__(self, limit: int, p: int = 1 << 21, n: int = 0) -> None:
        self.limit = limit
        self.p = p
        self.n = n

    def update(self, bit: int) -> None:
        """Learn from a bit."""
        if bit:
            self.p += (4194303 - self.p) * RATE[self.n] >> 16
        else:
            self.p -= self.p * RATE[self.n] >> 16
        if self.n < self.limit:
            self.n += 1


class Curve:
    """A refinement of mixed log odds (4.5)."""

    __slots__ = ("knots",)

    def __init__(self) -> None:
        self.knots = [SQUASH[64 * k] for k in range(48)] + [SQUASH[3071]]

    def at(self, t: int) -> int:
        """The probability that the curve gives for log odds t."""
        k, r = divmod(t + 1536, 64)
        return (self.knots[k] * (64 - r) + self.knots[k + 1] * r) >> 6

    def update(self, t: int, bit: int) -> None:
        """Move the knot that is nearest to t."""
        k = (t + 1536 + 32) >> 6
        knot = self.knots[k]
        self.knots[k] = knot + (65535 - knot >> 6) if bit else knot - (knot >> 6)


def mix(
    coder: RangeDecoder,
    states: list[State],
    weights: list[int],
    shift: int,
    curve: Curve | None = None,
    bound: int = 1 << 20,
) -> int:
    """Decode one decision by a mix of states (4.4); weights stay within [-bound, bound]."""
    odds = [STRETCH[s.p >> 10] for s in states]
    t = clamp(sum(map(mul, weights, odds)) >> 16, -1536, 1535)
    mixed = SQUASH[t + 1536]
    p = mixed if curve is None else (mixed + 3 * curve.at(t)) >> 2
    bit = coder.decode(clamp(p, 16, 65520))
    error = (bit << 16) - mixed
    weights[:] = [
        clamp(w + (o * error >> shift), -bound, bound) for w, o in zip(weights, odds, strict=True)
    ]
    for s in states:
        s.update(bit)
    if curve is not None:
        curve.update(t, bit)
    return bit


Decide = Callable[[int], int]
"""Decodes the decision of a number."""


def decode_size(decide: Decide, raw: Callable[[int], int]) -> int:
    """A size of at least 1 (4.6)."""
    b = 1
    while b < 32 and decide(1 + min(b, 14)):
        b += 1
    modelled = MODELLED[b]
    prefix = 1
    for _ in range(modelled):
        prefix = prefix << 1 | decide(FIRST[b] + prefix - 1)
    others = b - 1 - modelled
    return prefix << others | raw(others)


def decode_value(decide: Decide, raw: Callable[[int], int]) -> int:
    """A signed value (4.6)."""
    if not decide(0):
        return 0
    negative = decide(1)
    size = decode_size(decide, raw)
    return -size if negative else size


class NumberDecoder:
    """Numbers whose decisions have one state and one weight each, mixed alone with shift 14."""

    def __init__(self, coder: RangeDecoder, limit: int) -> None:
        self.coder = coder
        self.states: dict[int, State] = defaultdict(lambda: State(limit))
        self.weights: dict[int, list[int]] = defaultdict(lambda: [65536])

    def decide(self, d: int) -> int:
        """Decision d."""
        return mix(self.coder, [self.states[d]], self.weights[d], 14)

    def size(self) -> int:
        """A size."""
        return decode_size(self.decide, self.coder.raw)

    def value(self) -> int:
        """A value."""
        return decode_value(self.decide, self.coder.raw)
