"""Part 4: range coder, adaptive states, mixing, curves, numbers."""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable
from operator import mul
from typing import Protocol

from tests.codec.from_document.common import check, clamp

KNOT = [
    1, 1, 1, 1, 1, 1, 2, 2, 3, 4, 5, 6, 8, 10, 13, 17, 22, 28, 36, 47, 60, 77, 98, 126, 162,
    208, 267, 342, 439, 562, 720, 922, 1179, 1506, 1921, 2446, 3108, 3938, 4971, 6249, 7812,
    9702, 11955, 14595, 17625, 21025, 24743, 28693, 32768, 36843, 40793, 44511, 47911, 50941,
    53581, 55834, 57724, 59287, 60565, 61598, 62428, 63090, 63615, 64030, 64357, 64614, 64816,
    64974, 65097, 65194, 65269, 65328, 65374, 65410, 65438, 65459, 65476, 65489, 65500, 65508,
    65514, 65519, 65523, 65526, 65528, 65530, 65531, 65532, 65533, 65534, 65534, 65535, 65535,
    65535, 65535, 65535, 65535,
]  # fmt: skip
SQUASH = [  # index: log odds + 1536
    (KNOT[u // 32] * (32 - u % 32) + KNOT[u // 32 + 1] * (u % 32)) // 32 for u in range(3072)
]
STRETCH = [bisect_left(SQUASH, 16 * c + 8) - 1536 for c in range(4096)]
RATE = [655360 // (10 * n + 16) for n in range(1001)]

FIRST = (0, 0, 16, 17, 20, 27, 42, 73, 88) + 24 * (103,)  # 4.6, index: b
MODELLED = (0, 0, 1, 2, 3, 4, 5, 4, 4) + 24 * (3,)  # d of 4.6, index: b

LEVEL = [0, 1, 2, 3, 3, 4, 4, 4, 4] + 8 * [5] + 16 * [6] + [7]
SMALL = [0, 1, 1, 2, 2, 2, 2, 2, 2, 3]


def level(v: int) -> int:
    """Class of a number by its magnitude and sign (end of 4.6)."""
    return LEVEL[min(v, 33)] if v >= 0 else 8 + LEVEL[min(-v, 33)]


def small(v: int) -> int:
    """Class of a number by its magnitude (end of 4.6)."""
    return SMALL[min(abs(v), 9)]


class RangeDecoder:
    """The range decoder of 4.1."""

    def __init__(self, data: bytes, what: str) -> None:
        self.size = len(data)
        self.data = data + bytes(8)
        self.what = what
        self.offset = int.from_bytes(self.data[:4], "big")
        self.range = 2**32 - 1
        self.at = 4
        check(self.size > 0, f"{what}: stream cut")

    def decode(self, p: int) -> int:
        """One decision that is 1 with probability p / 65536."""
        bound = (self.range >> 16) * p
        bit = int(self.offset < bound)
        if bit:
            self.range = bound
        else:
            self.offset -= bound
            self.range -= bound
        while self.range < 1 << 24:
            check(self.at < self.size + 3, f"{self.what}: stream cut")
            self.range <<= 8
            self.offset = (self.offset << 8 | self.data[self.at]) & 0xFFFFFFFF
            self.at += 1
        return bit

    def raw(self, count: int = 1) -> int:
        """A number of `count` raw bits, highest first."""
        value = 0
        for _ in range(count):
            value = value << 1 | self.decode(32768)
        return value

    def finish(self) -> None:
        """After the last decision exactly three bytes must have been read past the end."""
        check(self.at == self.size + 3, f"{self.what}: bytes after the last decision")


class Decoder(Protocol):
    """What a mix needs of a range decoder."""

    def decode(self, p: int) -> int:
        """One decision."""


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
        """Move the knot next to t."""
        k = (t + 1536 + 32) >> 6
        knot = self.knots[k]
        self.knots[k] = knot + (65535 - knot >> 6) if bit else knot - (knot >> 6)


def mix(
    coder: Decoder,
    states: list[State],
    weights: list[int],
    shift: int,
    curve: Curve | None = None,
    bound: int = 1 << 20,
) -> int:
    """Code one decision by a mix of states (4.4); weights stay within [-bound, bound]."""
    odds = [STRETCH[s.p >> 10] for s in states]
    t = clamp(sum(map(mul, weights, odds)) >> 16, -1536, 1535)
    mixed = SQUASH[t + 1536]
    p = mixed if curve is None else (mixed + 3 * curve.at(t)) >> 2
    bit = coder.decode(clamp(p, 16, 65520))
    error = (bit << 16) - mixed
    weights[:] = [w + (o * error >> shift) for w, o in zip(weights, odds, strict=True)]
    if max(weights) > bound or min(weights) < -bound:
        weights[:] = [clamp(w, -bound, bound) for w in weights]
    for s in states:
        s.update(bit)
    if curve is not None:
        curve.update(t, bit)
    return bit


Decide = Callable[[int], int]


def decode_size(decide: Decide, raw: Callable[[int], int]) -> int:
    """A size of at least 1 (4.6); `decide` codes decision number d."""
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


class SoloNumbers:
    """Numbers whose decisions have one state and one weight each, mixed alone, shift 14."""

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
