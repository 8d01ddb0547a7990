"""``clgs info``: what a .clgs file holds, section by section."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from clgs.cli.options import named_path

LESS_MEMORY = "end other programs, or use a machine that has more"


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.description = (
        "Show the header and the sections of a .clgs file, with their bytes, or what a file of "
        "splats (.ply, .spz, .sog, .splat) holds."
    )
    parser.add_argument("scene", type=named_path, metavar="FILE", help="the file")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Print the description of a file; exit code 0."""
    import json

    from clgs.cli.tell import tell
    from clgs.codec import scene_decoder, splat_packing
    from clgs.workflow.scenes import SPLAT_SUFFIXES, describe_splats, naming, read_bytes

    description: dict[str, Any]
    if args.scene.suffix.lower() in SPLAT_SUFFIXES:
        description = describe_splats(args.scene)
    else:
        data = read_bytes(args.scene)
        with naming(args.scene):
            reader = splat_packing if splat_packing.is_splats(data) else scene_decoder
            description = reader.describe(data)
    if missing := description.get("missing"):
        tell(f"clgs: warning: {args.scene}: the file is cut; {missing:,} bytes are missing")
    if args.json:
        print(json.dumps(description, indent=2))
        return 0
    rows = list(flatten(description))
    width = max(len(name) for name, _ in rows)
    for name, value in rows:
        print(f"{name.ljust(width)}  {value}")
    return 0


def flatten(value: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """(dotted name, text) of every leaf; a list of plain values is one leaf."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from flatten(inner, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list | tuple) and any(isinstance(x, dict) for x in value):
        for index, inner in enumerate(value):
            yield from flatten(inner, f"{name}.{index}")
    elif isinstance(value, list | tuple):
        yield name, " ".join(map(str, value))
    else:
        yield name, f"{value:,}" if type(value) is int else str(value)
