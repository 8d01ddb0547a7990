"""``clgs devices``: the OpenCL devices of this machine."""

from __future__ import annotations

import argparse

HEADINGS = (
    *("", "index", "type", "name", "platform", "driver"),
    *("units", "memory", "work-group", "local", "lanes", "together"),
)


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.description = (
        "List the OpenCL devices; a star marks the one that is used by default. The number or "
        "a part of the name goes to --device of other commands. Devices with the same letter "
        "compute the same bits: --devices of `clgs train` takes them together."
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Print the devices; exit code 0."""
    import json
    from dataclasses import asdict
    from string import ascii_uppercase

    from clgs.opencl.choose import describe_devices

    devices = describe_devices()
    if args.json:
        print(json.dumps([asdict(device) for device in devices], indent=2))
        return 0
    rows, kinds = [HEADINGS], list(dict.fromkeys(one.kind for one in devices))
    for one in devices:
        named = "*" if one.chosen else "", str(one.index), one.type, one.name, one.platform
        memory, local = f"{one.memory / 2**30:.1f} GiB", f"{one.local_memory / 2**10:.0f} KiB"
        sizes = str(one.compute_units), memory, str(one.max_work_group), local
        letter = ascii_uppercase[kinds.index(one.kind) % len(ascii_uppercase)]
        rows.append((*named, one.driver, *sizes, str(one.vector_width), letter))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        line = "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print(line.rstrip())
    return 0
