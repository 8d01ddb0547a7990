"""`clgs bench codec`: size and speed of the codec's levels beside other compressors."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options.view import positive_int, seed
from clgs.cli.tell import tell

if TYPE_CHECKING:
    from rich.table import Table

    from clgs.lab.bench.codec import Figures, Subject

DESCRIPTION = """\
Bytes of every level, and times (medians of alternating runs, one thread), beside zstd -19, xz -9
and brotli 11 on the same integers in their narrowest type. DATA: .npz files with `values` (rows in
Morton order) or `positions`, .clgs files, or folders of them; without DATA seeded random numbers
with the published bits per number. The ratio is to the bytes of the published coder, if they are
known, otherwise to the level paper."""


def register(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the kind and its options."""
    parser = kinds.add_parser(
        "codec",
        help="the codec's levels: bytes, and times to encode and decode",
        description=DESCRIPTION,
    )
    add = parser.add_argument
    add("data", type=Path, nargs="*", metavar="DATA", help="files or folders")
    add(
        "--anchors",
        type=positive_int,
        help="number of anchors with seeded values (default: 312238)",
    )
    add("--quick", action="store_true", help="as --anchors 20000")
    add("--seed", type=seed, default=0, help="of the seeded numbers (default: 0)")
    add("--repeats", type=positive_int, default=3, help="runs to take the median of (default: 3)")
    add("--levels-only", action="store_true", help="without the other compressors, which are slow")
    add("--json", type=Path, metavar="F", help="write all figures to F")


def run(args: argparse.Namespace) -> int:
    """Measure and print; exit code 0."""
    from rich.console import Console

    from clgs.cli.progress import bar
    from clgs.files import check_target, write_json
    from clgs.lab.bench import codec_subjects
    from clgs.lab.bench.codec import bench_subject
    from clgs.lab.bench.facts import command_line
    from clgs.machine import host_facts

    if args.json:
        check_target(args.json)
    anchors = args.anchors or (
        codec_subjects.QUICK_ANCHORS if args.quick else codec_subjects.ANCHORS
    )
    subjects = (
        codec_subjects.file_subjects(args.data)
        if args.data
        else codec_subjects.seeded_subjects(anchors, args.seed)
    )
    table, records, said = _new_table(), [], set[str]()

    def note(line: str) -> None:
        if line not in said:
            tell(f"clgs: {line}")
        said.add(line)

    with bar(None, "runs") as advance:
        for subject in subjects:
            figures = bench_subject(subject, args.repeats, args.levels_only, note, advance)
            _add_rows(table, subject, figures)
            records.append(_record(subject, figures))
    Console().print(table)
    if args.json:
        write_json(args.json, {"command": command_line(), **host_facts(), "subjects": records})
    return 0


def _new_table() -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title="one thread", box=box.SIMPLE, pad_edge=False)
    for column in ("data", "coder"):
        table.add_column(column, no_wrap=True)
    for column, width in (
        ("bytes", 11),
        ("ratio", 6),
        ("bits", 7),
        ("encode s", 8),
        ("decode s", 8),
    ):
        table.add_column(column, justify="right", no_wrap=True, min_width=width)
    return table


def _add_rows(table: Table, subject: Subject, figures: list[Figures]) -> None:
    from clgs.lab.bench.codec import ratios

    table.add_section()
    name, each = subject.name, max(subject.symbols, 1)
    if subject.baseline:
        table.add_row(name, "published", f"{subject.baseline:,}", "1.000")
        name = ""
    for one, ratio in zip(figures, ratios(subject, figures), strict=True):
        table.add_row(
            name,
            one.coder,
            f"{one.bytes:,}",
            "" if ratio is None else f"{ratio:.3f}",
            f"{8 * one.bytes / each:.3f}",
            f"{one.encode_seconds:.3f}",
            f"{one.decode_seconds:.3f}",
        )
        name = ""


def _record(subject: Subject, figures: list[Figures]) -> dict[str, object]:
    from dataclasses import asdict

    from clgs.lab.bench.codec import ratios

    return {
        "name": subject.name,
        "kind": subject.kind,
        "symbols": subject.symbols,
        "baseline": subject.baseline,
        "coders": [
            {**asdict(one), "ratio": ratio}
            for one, ratio in zip(figures, ratios(subject, figures), strict=True)
        ],
    }
