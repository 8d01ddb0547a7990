"""Tables in Markdown of what was recorded."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from estimate import Kernel, Row, kernels, row, rows, scaling_errors
from units import units_of

ARROW = " → "
NONE = "-"

HEADER = (
    "| stage | launches | warp instructions, millions | SIMT efficiency | sector efficiency "
    "| wavefronts over ideal | estimate, µs | what binds |"
)


def stages(table: dict[str, Any], bench: str) -> str:
    """A line a stage: the states of the table side by side, in their order."""
    found = [kernels(state, bench) for state in table.values()]
    by_stage = [rows(each) for each in found]
    names = dict.fromkeys(name for each in reversed(by_stage) for name in each)
    lines = [HEADER, "|" + "---|" * HEADER[1:].count("|")]
    lines += [stage(name, [each.get(name) for each in by_stage]) for name in names]
    return "\n".join([*lines, stage("**all**", [row(each) for each in found])])


def stage(name: str, states: list[Row | None]) -> str:
    """A line of the table; values that all states share stand once."""
    cells = [[NONE] * 7 if one is None else cells_of(one) for one in states]
    columns = zip(*cells, strict=True)
    joined = [one[0] if len(set(one)) == 1 else ARROW.join(one) for one in columns]
    return f"| {name} | {' | '.join(joined)} |"


def cells_of(one: Row) -> list[str]:
    """Of a state and a stage."""
    return [
        str(one.launches),
        f"{one.warp_instructions:.2f}",
        f"{one.simt_efficiency:.0%}",
        f"{one.sector_efficiency:.0%}",
        f"{one.conflicts:.2f}",
        f"{one.bound.time:.0f}",
        one.bound.binds,
    ]


def by_kernel(state: dict[str, Any], bench: str) -> Iterator[str]:
    """A line a kernel, the slowest first."""
    yield (
        "| kernel | unit | launches | warp instructions, millions | SIMT | sectors | wavefronts "
        "| estimate, µs | what binds |"
    )
    yield "|" + "---|" * 9
    for one in sorted(kernels(state, bench), key=lambda one: -one.bound.time):
        cells = cells_of(row([one]))
        yield f"| {one.stage}: {one.name} | {_units(one)} | {' | '.join(cells)} |"


def _units(one: Kernel) -> str:
    return " and ".join(units_of(one.name))


def scaling(state: dict[str, Any]) -> Iterator[str]:
    """A line a kernel, those with most instructions first: counts scaled, and counted."""
    errors = scaling_errors(state)
    yield "| kernel | scaled | counted | error |"
    yield "|" + "---|" * 4
    for key, (guess, true) in sorted(errors.items(), key=lambda item: -item[1][1]):
        yield f"| {key} | {guess:.0f} | {true:.0f} | {guess / true - 1:+.1%} |"
    guesses, trues = (sum(each) for each in zip(*errors.values(), strict=True))
    yield f"| **all** | {guesses:.0f} | {trues:.0f} | {guesses / trues - 1:+.1%} |"
