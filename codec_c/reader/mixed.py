"""The residuals of mixed channels: 7.5 of FORMAT.md."""

from __future__ import annotations

from collections import defaultdict

from .coding import Curve, RangeDecoder, State, clamp, decode_value, level, mix, small, unzigzag

LIMITS = (1000, 30, 250, 250, 250, 250, 250, 250, 250)  # plain, quick, cell ... trend


def place(x: int, m: int) -> int:
    """x as a number of [0, 2 m)."""
    return clamp(x, -m, m - 1) + m


class MixedModel:
    """The states, weights and curves of a mixed channel of a chunk (7.5)."""

    def __init__(self, coder: RangeDecoder, symbols: list[list[int]], n: int) -> None:
        """`symbols` are those of all channels so far; the last ones are our own."""
        self.coder = coder
        self.n = n
        self.own, self.before, self.before2 = [*symbols[-3:][::-1], n * [0], n * [0]][:3]
        self.states = [
            defaultdict[object, dict[int, State]](
                lambda limit=limit: defaultdict(lambda: State(limit))
            )
            for limit in LIMITS
        ]
        self.weights: dict[tuple[int, int], list[int]] = defaultdict(lambda: 9 * [10485])
        self.curves: dict[int, Curve] = defaultdict(Curve)
        self.a = self.b = 0

    def signed(self, symbols: list[int], i: int) -> int:
        """The symbol at row i as a signed number."""
        return unzigzag(symbols[i]) if 0 <= i < self.n else 0

    def residual(self, i: int, cell: int, expected: int, fraction: int) -> int:
        """The residual at row i."""
        own1 = self.signed(self.own, i - 1)
        around = self.signed(self.before, i - 1) + self.signed(self.before, i + 1)
        contexts: tuple[object, ...] = (
            0,
            fraction,
            cell,
            place(expected, 32),
            (level(own1), small(self.signed(self.own, i - 2))),
            (level(self.signed(self.before, i)), small(self.signed(self.before2, i))),
            (level(around), small(own1)),
            (place(expected, 32), cell % 32 // 2),
            (place((self.a >> 8) - expected, 16), place((self.b >> 8) - expected, 16)),
        )
        by_decision = [
            states[context] for states, context in zip(self.states, contexts, strict=True)
        ]
        crowd = cell % 32 // 8

        def decide(d: int) -> int:
            states = [states[d] for states in by_decision]
            return mix(self.coder, states, self.weights[d, crowd], 14, self.curves[d])

        return decode_value(decide, self.coder.raw)

    def learn(self, value: int) -> None:
        """Take note of v' of a row."""
        self.a += 256 * value - self.a >> 3
        self.b += 256 * value - self.b >> 6
