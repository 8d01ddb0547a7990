"""`clgs bench step`: how long a training step takes on this device, stage by stage."""

from __future__ import annotations

import argparse

from clgs.lab.workload_options import add_step_options


def register(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the kind and its options."""
    step = kinds.add_parser("step", help="one training step on a seeded synthetic scene")
    add_step_options(step)


def run(args: argparse.Namespace) -> int:
    """Measure and print; exit code 0."""
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from clgs.files import check_target, write_json
    from clgs.lab.bench.facts import command_line, machine_facts
    from clgs.lab.bench.step import bench_step
    from clgs.opencl.device import Device

    if args.json:
        check_target(args.json)
    device = Device(args.device)
    times = bench_step(device, args.gaussians, args.size, args.repeats, args.seed)
    title = (
        f"{device.name} ({device.specialisation}): {times.anchors:,} anchors, "
        f"{times.gaussians:,} Gaussians, {times.intersections:,} intersections, "
        f"{args.size[0]}x{args.size[1]} px"
    )
    table = Table("stage", title=title)
    table.add_column("median ms", justify="right")
    for name, milliseconds in times.stages.items():
        table.add_row(name, f"{milliseconds:.2f}")
    table.add_section()
    table.add_row("whole step", f"{times.step:.2f}")
    table.add_row("render only", f"{times.render:.2f}")
    table.add_section()
    table.add_row("kernels of a step, by the device's clock", f"{sum(times.kernels.values()):.2f}")
    table.add_row("host in a step, but for waits", f"{times.host:.2f}")
    table.add_row("waits in a step", f"{times.waits:.1f}")
    table.add_row("launches of a step", str(times.launches))
    Console().print(table)
    if args.json:
        facts = {"command": command_line(), **machine_facts(device)}
        write_json(args.json, facts | asdict(times))
    return 0
