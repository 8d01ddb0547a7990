"""Range coders, adaptive states and mixing, for reading (FORMAT.md on the range coder).

Plain integers, one decision at a time. ``octree`` and ``runlength`` build on it, and give the very
bytes that the C coder gives.
"""

from __future__ import annotations

from typing import Protocol

ODDS_LIMIT = 1536
"""Log odds are in 1/128 nat, from -ODDS_LIMIT to ODDS_LIMIT - 1."""

MIN_PROBABILITY = 16
WEIGHT_ONE = 65536
WEIGHT_LIMIT = 16 * WEIGHT_ONE
CURVE_KNOTS, KNOT_STEP = 49, 64

# fmt: off
SQUASH_KNOTS = [
    1, 1, 1, 1, 1, 1, 2, 2, 3, 4, 5, 6, 8, 10, 13, 17, 22, 28, 36, 47, 60, 77, 98, 126, 162, 208,
    267, 342, 439, 562, 720, 922, 1179, 1506, 1921, 2446, 3108, 3938, 4971, 6249, 7812, 9702,
    11955, 14595, 17625, 21025, 24743, 28693, 32768, 36843, 40793, 44511, 47911, 50941, 53581,
    55834, 57724, 59287, 60565, 61598, 62428, 63090, 63615, 64030, 64357, 64614, 64816, 64974,
    65097, 65194, 65269, 65328, 65374, 65410, 65438, 65459, 65476, 65489, 65500, 65508, 65514,
    65519, 65523, 65526, 65528, 65530, 65531, 65532, 65533, 65534, 65534, 65535, 65535, 65535,
    65535, 65535, 65535,
]
# fmt: on
"""65536 / (1 + exp(-odds)) every 32 units of log odds, within [1, 65535]."""


def _squash(place: int) -> int:
    knot, part = divmod(place, 32)
    return (SQUASH_KNOTS[knot] * (32 - part) + SQUASH_KNOTS[min(knot + 1, 96)] * part) // 32


SQUASH = [_squash(place) for place in range(2 * ODDS_LIMIT)]
"""Probability in 1/65536 of log odds ``place - ODDS_LIMIT``."""


def _stretch_table() -> list[int]:
    """For each of 4096 cells of probability, the least log odds that reach its middle."""
    table: list[int] = []
    for place, p in enumerate(SQUASH):
        while len(table) < 4096 and 16 * len(table) + 8 <= p:
            table.append(place - ODDS_LIMIT)
    return table


STRETCH = _stretch_table()
RATE = [655360 // (10 * count + 16) for count in range(1024)]
"""A state that has seen ``count`` bits moves by RATE / 65536 of the distance."""


class Coder(Protocol):
    """Both directions of the range coder."""

    def code(self, bit: int, p: int) -> int:
        """Code ``bit``, 1 with probability p / 65536; a decoder ignores ``bit``. The bit."""


class RangeEncoder:
    """Narrows an interval of the number line; ``low`` grows by a byte with every shift."""

    def __init__(self) -> None:
        self.low, self.range, self.shifts = 0, 0xFFFFFFFF, 0

    def code(self, bit: int, p: int) -> int:
        """Code one bit."""
        bound = (self.range >> 16) * p
        if bit:
            self.range = bound
        else:
            self.low += bound
            self.range -= bound
        while self.range < 1 << 24:
            self.range <<= 8
            self.low <<= 8
            self.shifts += 1
        return bit

    def finish(self) -> bytes:
        """The shortest bytes that, followed by zeros, name a number in the interval."""
        return (-(-self.low >> 24)).to_bytes(self.shifts + 1, "big")


class RangeDecoder:
    """Follows a number into the intervals of the encoder."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at, self.range = data, 4, 0xFFFFFFFF
        self.offset = int.from_bytes(data[:4].ljust(4, b"\0"), "big")

    def code(self, bit: int, p: int) -> int:
        """Decode one bit."""
        bound = (self.range >> 16) * p
        bit = int(self.offset < bound)
        if bit:
            self.range = bound
        else:
            self.offset -= bound
            self.range -= bound
        while self.range < 1 << 24:
            self.range <<= 8
            self.offset = self.offset << 8 | (self.data[self.at] if self.at < len(self.data) else 0)
            self.at += 1
        if self.at > len(self.data) + 3:
            raise ValueError("the stream ends before its last symbol")
        return bit

    def finish(self) -> None:
        """Raise ValueError unless the stream ends here: three zeros are read past its end."""
        if self.at != len(self.data) + 3:
            raise ValueError("bytes follow the last symbol of the stream")


class WideCoder(Coder, Protocol):
    """Both directions of the range coder of 64 bits."""

    def plain(self, value: int, bits: int) -> int:
        """Code ``value`` below 2^bits, all alike likely; a decoder ignores it. The value."""


class WideEncoder:
    """As RangeEncoder, but 64 bits wide and moving by 32."""

    def __init__(self) -> None:
        self.low, self.range, self.shifts = 0, (1 << 64) - 1, 0

    def code(self, bit: int, p: int) -> int:
        """Code one bit."""
        bound = (self.range >> 16) * p
        if bit:
            self.range = bound
        else:
            self.low += bound
            self.range -= bound
        self._shift()
        return bit

    def plain(self, value: int, bits: int) -> int:
        """Code at most 16 bits."""
        self.range >>= bits
        self.low += self.range * value
        self._shift()
        return value

    def _shift(self) -> None:
        if self.range < 1 << 32:
            self.range <<= 32
            self.low <<= 32
            self.shifts += 4

    def finish(self) -> bytes:
        """The shortest bytes that, followed by zeros, name a number in the interval."""
        while self.range < 1 << 56:
            self.range <<= 8
            self.low <<= 8
            self.shifts += 1
        return (-(-self.low >> 56)).to_bytes(self.shifts + 1, "big")


class WideDecoder:
    """Follows a number into the intervals of the encoder."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at, self.range = data, 8, (1 << 64) - 1
        self.offset = int.from_bytes(data[:8].ljust(8, b"\0"), "big")

    def code(self, bit: int, p: int) -> int:
        """Decode one bit."""
        bound = (self.range >> 16) * p
        bit = int(self.offset < bound)
        if bit:
            self.range = bound
        else:
            self.offset -= bound
            self.range -= bound
        self._shift()
        return bit

    def plain(self, value: int, bits: int) -> int:
        """Decode at most 16 bits."""
        self.range >>= bits
        value = self.offset // self.range
        if value >> bits:
            raise ValueError("the stream holds what no encoder writes")
        self.offset -= self.range * value
        self._shift()
        return value

    def _shift(self) -> None:
        if self.range < 1 << 32:
            word = self.data[self.at : self.at + 4].ljust(4, b"\0")
            self.offset = self.offset << 32 | int.from_bytes(word, "big")
            self.range <<= 32
            self.at += 4
        if self.at > len(self.data) + 7:
            raise ValueError("the stream ends before its last symbol")

    def finish(self) -> None:
        """Raise ValueError unless the stream ends where an encoder would have ended it."""
        written = self.at - 7
        while self.range < 1 << 56:
            self.range <<= 8
            written += 1
        if written != len(self.data):
            raise ValueError("the stream does not end after its last symbol")


class State:
    """An adaptive probability of a 1, in 1/2^22, and the number of bits seen up to ``limit``."""

    def __init__(self, limit: int, p: int = 1 << 21, count: int = 0) -> None:
        self.p, self.count, self.limit = p, count, limit

    def update(self, bit: int) -> None:
        """Move towards ``bit``."""
        if bit:
            self.p += ((1 << 22) - 1 - self.p) * RATE[self.count] >> 16
        else:
            self.p -= self.p * RATE[self.count] >> 16
        self.count = min(self.count + 1, self.limit)


class Curve:
    """A learned map from log odds to probability, linear between its 49 knots."""

    def __init__(self) -> None:
        self.knots = [SQUASH[min(KNOT_STEP * k, 2 * ODDS_LIMIT - 1)] for k in range(CURVE_KNOTS)]

    def look_up(self, place: int) -> int:
        """Probability in 1/65536."""
        knot, part = divmod(place, KNOT_STEP)
        return (self.knots[knot] * (KNOT_STEP - part) + self.knots[knot + 1] * part) // KNOT_STEP

    def update(self, place: int, bit: int) -> None:
        """Move the nearer knot towards ``bit``."""
        knot = (place + KNOT_STEP // 2) // KNOT_STEP
        p = self.knots[knot]
        self.knots[knot] = p + ((65535 - p) >> 6) if bit else p - (p >> 6)


def code_mixed(
    coder: Coder,
    bit: int,
    states: list[State],
    weights: list[int],
    shift: int,
    curve: Curve | None = None,
    weight_limit: int = WEIGHT_LIMIT,
) -> int:
    """Code ``bit`` with the weighted log odds of ``states``, and let all of them learn."""
    odds = [STRETCH[state.p >> 10] for state in states]
    total = sum(w * o for w, o in zip(weights, odds, strict=True)) >> 16
    place = min(max(total, -ODDS_LIMIT), ODDS_LIMIT - 1) + ODDS_LIMIT
    mixed = p = SQUASH[place]
    if curve is not None:
        p = (mixed + 3 * curve.look_up(place)) >> 2
    bit = coder.code(bit, min(max(p, MIN_PROBABILITY), 65536 - MIN_PROBABILITY))
    error = (bit << 16) - mixed
    for i, state in enumerate(states):
        moved = weights[i] + (odds[i] * error >> shift)
        weights[i] = min(max(moved, -weight_limit), weight_limit)
        state.update(bit)
    if curve is not None:
        curve.update(place, bit)
    return bit
