"""`clgs bench gsplat`: this device beside gsplat, on the same Gaussians."""

from __future__ import annotations

import argparse
from typing import Any

from clgs.lab.workload_options import add_step_options

ROWS = {
    "lists of the tiles": ("tiles", "tiles"),
    "rasteriser forward": ("blend forward", "forward"),
    "rasteriser backward": ("blend backward", "backward"),
}
"""Of the table: the stage of `clgs bench step`, and the time of gsplat."""


def register(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the kind and its options."""
    parser = kinds.add_parser(
        "gsplat",
        help="rasteriser and step beside gsplat's (needs torch with CUDA, and gsplat)",
        description="Times of this device and of gsplat on the same Gaussians of a seeded "
        "synthetic scene: on the same card if --device names it. The step of clgs has MLPs, "
        "that of gsplat has none.",
    )
    add_step_options(parser)


def run(args: argparse.Namespace) -> int:
    """Measure and print; exit code 0."""
    from dataclasses import asdict

    from clgs.files import check_target, write_json
    from clgs.lab.bench.facts import command_line, machine_facts
    from clgs.lab.bench.peer.gsplat_times import require_gsplat, time_gsplat
    from clgs.lab.bench.peer.handover import hand_over
    from clgs.lab.bench.step import synthetic_trainer, time_steps
    from clgs.opencl.device import Device

    if args.json:
        check_target(args.json)
    require_gsplat()
    device = Device(args.device)
    trainer = synthetic_trainer(device, args.gaussians, args.size, args.seed)
    camera = trainer.dataset.train[0].camera
    view = hand_over(device, trainer.render_next(), camera)
    ours, theirs = time_steps(trainer, args.repeats), time_gsplat(view, args.repeats, args.seed)
    record = {
        "clgs": {"step": ours.step, **{name: ours.stages[name] for name, _ in ROWS.values()}},
        "gsplat": asdict(theirs),
        "gaussians": ours.gaussians,
    }
    _show(device.name, record)
    if args.json:
        write_json(args.json, {"command": command_line(), **machine_facts(device)} | record)
    return 0


def _show(name: str, record: dict[str, Any]) -> None:
    """The table for people."""
    from rich.console import Console
    from rich.table import Table

    ours, theirs = record["clgs"], record["gsplat"]
    title = f"{name}; gsplat on {theirs['card']}; {record['gaussians']:,} Gaussians"
    table = Table("median ms", title=title)
    for column in ("clgs", "gsplat", "ratio"):
        table.add_column(column, justify="right")
    pairs = {row: (ours[stage], theirs[time]) for row, (stage, time) in ROWS.items()}
    pairs["whole step"] = ours["step"], theirs["step"]
    for row, (own, other) in pairs.items():
        table.add_row(row, f"{own:.3f}", f"{other:.3f}", f"{own / other:.2f}")
    Console().print(table)
    print(f"loss of gsplat's step: {theirs['loss']}; pictures differ by {theirs['difference']:.1e}")
