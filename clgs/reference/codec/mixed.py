"""Mixed channels of attributes, for reading (FORMAT.md on mixed channels); same bytes as C."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

from clgs.reference.codec.coding import Coder, Curve, State, code_mixed
from clgs.reference.codec.prediction import clamp, rounded, wrap, wrapped_difference
from clgs.reference.codec.runlength import Symbol, level, small_level

LIMITS = (1000, 30, 250, 250, 250, 250, 250, 250, 250)
FIRST_WEIGHT, SHIFT, NEAR, DRIFT = 65536 * 16 // 100, 14, 32, 16


class Decisions(Symbol):
    """Decisions of residuals: nine states each, weights by a set, and a curve per decision."""

    def __init__(self) -> None:
        super().__init__(LIMITS)
        start = [FIRST_WEIGHT] * len(LIMITS)
        self.sets: dict[tuple[int, int], list[int]] = defaultdict(lambda: list(start))
        self.curves: dict[int, Curve] = defaultdict(Curve)
        self.set = 0

    def bit(self, coder: Coder, node: int, bit: int) -> int:
        """Code one decision in the current contexts."""
        states = [
            self.states.setdefault((i, context, node), State(limit))
            for i, (context, limit) in enumerate(zip(self.contexts, self.limits, strict=True))
        ]
        weights = self.sets[self.set, node]
        return code_mixed(coder, bit, states, weights, SHIFT, self.curves[node])


@dataclass
class Column:
    """Column j of a chunk, to be coded: values and symbols of it and of all earlier ones.

    sum_of_terms and cell give those of a row from what is known before it.
    """

    j: int
    values: list[list[int]]
    symbols: list[list[int]]
    has_taps: bool
    sum_of_terms: Callable[[int], int]
    cell: Callable[[int], int]
    symbol_of: Callable[[int], int]


def code_column(coder: Coder, column: Column) -> None:
    """Code all rows: an encoder reads the values, a decoder sets values and symbols."""
    decisions, values = Decisions(), column.values[column.j]
    quick = slow = 0
    for i in range(len(values)):
        total, cell = column.sum_of_terms(i), column.cell(i)
        one, two = (clamp(values[i - back]) if i >= back else 0 for back in (1, 2))
        expected = rounded(total) if column.has_taps else (one + two) >> 1
        trend = [_place((a >> 8) - expected, DRIFT) for a in (quick, slow)]
        near = _place(expected, NEAR)
        joint = 16 * near + cell % 32 // 2
        neighbours = _neighbours(column, i)
        fraction = total % 1024 // 128
        decisions.contexts = (
            0,
            fraction,
            cell,
            near,
            *neighbours,
            joint,
            2 * DRIFT * trend[0] + trend[1],
        )
        decisions.set = cell % 32 // 8
        residual = wrap(decisions.value(coder, wrapped_difference(values[i], total)))
        values[i] = wrap(residual + rounded(total))
        zigzag = 2 * residual if residual >= 0 else -2 * residual - 1
        column.symbols[column.j][i] = column.symbol_of(zigzag)
        quick += (256 * clamp(values[i]) - quick) >> 3
        slow += (256 * clamp(values[i]) - slow) >> 6


def _neighbours(column: Column, i: int) -> tuple[int, int, int]:
    """Contexts from symbols beside row i: own column, columns before, column before beside it."""
    rows = len(column.values[column.j])

    def symbol(channel: int, row: int) -> int:
        if channel < 0 or not 0 <= row < rows:
            return 0
        symbol = column.symbols[channel][row]
        return -(symbol >> 1) - 1 if symbol % 2 else symbol >> 1

    j = column.j
    one, two = symbol(j, i - 1), symbol(j, i - 2)
    beside = symbol(j - 1, i - 1) + symbol(j - 1, i + 1)
    return (
        4 * level(one) + small_level(two),
        4 * level(symbol(j - 1, i)) + small_level(symbol(j - 2, i)),
        4 * level(beside) + small_level(one),
    )


def _place(value: int, limit: int) -> int:
    return min(max(value, -limit), limit - 1) + limit
