"""`clgs bench ops`: time and error of every stage, beside what the device can do at most."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options.device import add_device_option, open_devices
from clgs.cli.options.view import positive_int, seed
from clgs.lab.workload_options import edge_length, element_count, gaussian_count

if TYPE_CHECKING:
    from clgs.lab.bench.ops import OpsFigures, StageFigures, Workload
    from clgs.opencl.device import Device

DESCRIPTION = """\
Time of every stage (median) and its largest error against float64, on every device. GB/s and
GFLOP/s count what a stage must move and compute at least (clgs/lab/bench/stage_work.py states the
formulas); the last column is its share of the copy bandwidth or of the FMA rate that the device
reaches, whichever is larger. Exit code 1 if an error exceeds its limit."""


def register(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the kind and its options."""
    parser = kinds.add_parser(
        "ops",
        help="every stage: time, error, share of the device's limits",
        description=DESCRIPTION,
    )
    add = parser.add_argument
    add(
        "--gaussians", type=gaussian_count, help="Gaussians with positive opacity (default: 200000)"
    )
    add("--size", type=edge_length, help="width and height of the image, pixels (default: 400)")
    add("--elements", type=element_count, help="for stages timed alone (default: 1000000)")
    add("--repeats", type=positive_int, help="runs to take the median of (default: 15)")
    add("--seed", type=seed, help="of the scene (default: 0)")
    add_device_option(parser)
    add("--json", type=Path, metavar="F", help="write all figures to F")


def run(args: argparse.Namespace) -> int:
    """Measure and print; exit code 0, or 1 if an error exceeds its limit."""
    from clgs.files import check_target, write_json
    from clgs.lab.bench.ops import bench_ops

    if args.json:
        check_target(args.json)
    records, passed = [], True
    for _, device in open_devices(args.device):
        load = _workload(args, device)
        figures = bench_ops(device, load)
        passed &= figures.passed
        records.append(_record(device, load, figures))
        _show(device, figures)
    if args.json:
        write_json(args.json, _document(records))
    return 0 if passed else 1


def _workload(args: argparse.Namespace, device: Device) -> Workload:
    from dataclasses import fields, replace

    from clgs.lab.bench.ops import TINY, Workload

    given = {field.name: getattr(args, field.name) for field in fields(Workload)}
    chosen = {name: value for name, value in given.items() if value is not None}
    return replace(TINY if device.is_emulator else Workload(), **chosen)


def _document(records: list[dict[str, object]]) -> dict[str, object]:
    from clgs.lab.bench.facts import command_line
    from clgs.lab.bench.stage_work import formula_lines

    return {"command": command_line(), "formulas": formula_lines(), "devices": records}


def _record(device: Device, load: Workload, figures: OpsFigures) -> dict[str, object]:
    from dataclasses import asdict

    from clgs.lab.bench.facts import machine_facts

    return machine_facts(device) | {"workload": asdict(load), **asdict(figures)}


def _show(device: Device, figures: OpsFigures) -> None:
    from rich.console import Console
    from rich.table import Table

    limits, counts = figures.limits, figures.counts
    title = (
        f"{device.name} ({device.specialisation}): copies {limits.bytes_per_second / 1e9:.1f} GB/s,"
        f" {limits.flops_per_second / 1e9:.0f} GFLOP/s; {counts.A:,} anchors, {counts.N:,} "
        f"Gaussians, {counts.I:,} intersections, {counts.B:,} blended pairs, {counts.P:,} pixels"
    )
    table = Table("stage", title=title)
    for column in ("ms", "error", "limit", "GB/s", "GFLOP/s", "of limit"):
        table.add_column(column, justify="right")
    for stage in figures.stages:
        table.add_row(stage.stage, *_cells(stage))
    Console().print(table)


def _cells(stage: StageFigures) -> list[str]:
    check, share = stage.check, stage.share
    cells = [f"{stage.milliseconds:.2f}", "", ""]
    if check is not None:
        cells[1:] = [f"{check.error:.1e}", f"{check.limit:.0e}{'' if check.passed else ' FAIL'}"]
    if share is None:
        return [*cells, "", "", ""]
    rates = f"{share.gigabytes_per_second:.1f}", f"{share.gigaflops:.1f}"
    return [*cells, *rates, f"{100 * share.of_limit:.0f} % {share.bound}"]
