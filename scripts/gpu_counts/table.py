"""Tables in Markdown of what was recorded."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from estimate import Row, kernels, row, rows, scaling_errors
from units import units_of

COLUMNS = (
    "launches | warp instructions, millions | SIMT efficiency | sector efficiency "
    "| wavefronts over ideal | estimate, µs | what binds |"
)


def by_stage(state: dict[str, Any], bench: str) -> Iterator[str]:
    """A line per stage, and one for all."""
    found = kernels(state, bench)
    yield f"| stage | {COLUMNS}"
    yield "|" + "---|" * 8
    for name, one in {**rows(found), "**all**": row(found)}.items():
        yield f"| {name} | {cells_of(one)} |"


def by_kernel(state: dict[str, Any], bench: str) -> Iterator[str]:
    """A line per kernel, the slowest first."""
    yield f"| kernel | unit | {COLUMNS}"
    yield "|" + "---|" * 9
    for one in sorted(kernels(state, bench), key=lambda one: -one.bound.time):
        units = " and ".join(units_of(one.name))
        yield f"| {one.stage}: {one.name} | {units} | {cells_of(row([one]))} |"


def cells_of(one: Row) -> str:
    """The cells of a line after its names."""
    return (
        f"{one.launches} | {one.warp_instructions:.2f} | {one.simt_efficiency:.0%} "
        f"| {one.sector_efficiency:.0%} | {one.conflicts:.2f} | {one.bound.time:.0f} "
        f"| {one.bound.binds}"
    )


def scaling(state: dict[str, Any]) -> Iterator[str]:
    """A line per kernel, those with most instructions first: counts scaled, and counted."""
    errors = scaling_errors(state)
    yield "| kernel | scaled | counted | error |"
    yield "|" + "---|" * 4
    for key, (guess, true) in sorted(errors.items(), key=lambda item: -item[1][1]):
        yield f"| {key} | {guess:.0f} | {true:.0f} | {guess / true - 1:+.1%} |"
    guesses, trues = (sum(each) for each in zip(*errors.values(), strict=True))
    yield f"| **all** | {guesses:.0f} | {trues:.0f} | {guesses / trues - 1:+.1%} |"
