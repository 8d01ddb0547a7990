"""Tables in Markdown of what was recorded."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from estimate import Row, kernels, row, rows
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
