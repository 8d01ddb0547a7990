"""Part 7.5: mixed channels."""

from __future__ import annotations

from collections import defaultdict

from tests.codec.from_document.common import clamp, unzigzag
from tests.codec.from_document.entropy import (
    Curve,
    RangeDecoder,
    State,
    decode_value,
    level,
    mix,
    small,
)

LIMITS = (1000, 30, 250, 250, 250, 250, 250, 250, 250)  # plain, quick, cell ... trend


def place(x: int, m: int) -> int:
    """x as a number of [0, 2 m)."""
    return clamp(x, -m, m - 1) + m


class ByDecision(dict[int, State]):
    """States of one context, one per decision."""

    def __init__(self, limit: int) -> None:
        super().__init__()
        self.limit = limit

    def __missing__(self, d: int) -> State:
        state = self[d] = State(self.limit)
        return state


class ByContext(dict[object, ByDecision]):
    """States of one of the nine kinds, by what selects them."""

    def __init__(self, limit: int) -> None:
        super().__init__()
        self.limit = limit

    def __missing__(self, context: object) -> ByDecision:
        states = self[context] = ByDecision(self.limit)
        return states


class MixedChannel:
    """Decodes the residuals of one mixed channel of a chunk."""

    def __init__(
        self, coder: RangeDecoder, symbols: list[list[int]], clamped: list[int], n: int
    ) -> None:
        """`symbols`: of all channels so far, the last one is ours; `clamped`: our v'."""
        self.coder = coder
        self.own = symbols[-1]
        zeros = n * [0]
        self.beside = symbols[-2] if len(symbols) > 1 else zeros
        self.beside2 = symbols[-3] if len(symbols) > 2 else zeros
        self.clamped = clamped
        self.n = n
        self.kinds = [ByContext(limit) for limit in LIMITS]
        self.weights: dict[tuple[int, int], list[int]] = defaultdict(lambda: 9 * [10485])
        self.curves: dict[int, Curve] = defaultdict(Curve)
        self.a = self.b = 0

    def expected(self, i: int) -> int:
        """What is expected at row i without taps."""
        one = self.clamped[i - 1] if i >= 1 else 0
        two = self.clamped[i - 2] if i >= 2 else 0
        return one + two >> 1

    def signed(self, symbols: list[int], i: int) -> int:
        """The symbol at row i as a signed number."""
        return unzigzag(symbols[i]) if 0 <= i < self.n else 0

    def residual(self, i: int, cell: int, expected: int, fraction: int) -> int:
        """The residual at row i."""
        own1 = self.signed(self.own, i - 1)
        around = self.signed(self.beside, i - 1) + self.signed(self.beside, i + 1)
        cross = level(self.signed(self.beside, i)), small(self.signed(self.beside2, i))
        contexts: tuple[object, ...] = (
            0,
            fraction,
            cell,
            place(expected, 32),
            (level(own1), small(self.signed(self.own, i - 2))),
            cross,
            (level(around), small(own1)),
            (place(expected, 32), cell % 32 // 2),
            (place((self.a >> 8) - expected, 16), place((self.b >> 8) - expected, 16)),
        )
        by_decision = [kind[context] for kind, context in zip(self.kinds, contexts, strict=True)]
        crowd = cell % 32 // 8

        def decide(d: int) -> int:
            states = [states[d] for states in by_decision]
            return mix(self.coder, states, self.weights[d, crowd], 14, self.curves[d])

        return decode_value(decide, self.coder.raw)

    def learn(self, i: int) -> None:
        """Take note of v' at row i."""
        v = 256 * self.clamped[i]
        self.a += v - self.a >> 3
        self.b += v - self.b >> 6
