"""`clgs conformance`: hashes of renders and gradients of fixed scenes, to compare devices by."""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options import add_overwrite, named_path
from clgs.lab.selftest import SHIPPED

if TYPE_CHECKING:
    from clgs.lab.selftest.conformance import Fingerprint

DESCRIPTION = """\
SHA-256 of every tensor that the kernels compute for fixed scenes: renders, gradients and all stages
in between. With --check: whether another device made the same bits, without a FILE the CPU that
these hashes were made on; names the first stage that did not. Both forms of the kernels, for CPUs
and for GPUs, make the same bits if a device rounds as IEEE 754 does. Exit code 1 if any tensor
differs."""

LARGEST_RECORD = 1 << 24
"""Bytes; today's have 20 thousand."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = DESCRIPTION
    add = parser.add_argument
    add("-o", "--output", type=named_path, metavar="FILE", help="write the hashes to FILE (JSON)")
    add(
        "--check",
        type=named_path,
        nargs="?",
        const=SHIPPED,
        metavar="FILE",
        help="compare with the hashes in FILE; default: with those that clgs comes with",
    )
    add("--device", help="number or part of the name, see `clgs devices`")
    add_overwrite(parser, "the FILE of -o if it exists (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Compute, write and compare; exit code 0, or 1 if a tensor differs.

    Raises:
        DataError: FILE of ``--check`` holds no hashes, or those of other tensors.
    """
    from clgs.errors import DataError
    from clgs.files import write_json
    from clgs.lab.figures import machine_facts
    from clgs.lab.selftest import conformance
    from clgs.opencl.device import Device
    from clgs.workflow.outputs import check_new

    if args.output:
        check_new(args.output, args.overwrite)
    wanted = read_hashes(args.check) if args.check else []
    device = Device(args.device)
    found, roundings = conformance.fingerprints(device), conformance.roundings(device)
    facts = machine_facts(device) | {"wrongly_rounded": roundings}
    together = hashlib.sha256("".join(one.sha256 for one in found).encode()).hexdigest()[:16]
    print(f"{device.name} ({device.specialisation}): {len(found)} tensors, together {together}")
    if args.output:
        write_json(args.output, conformance.to_record(found, facts))
    if args.check is None:
        return 0
    try:
        different = conformance.differences(found, wanted)
    except DataError as error:
        raise DataError(f"{args.check}: {error}") from error
    if not different:
        print(f"check: all {len(found)} tensors are bit-identical")
        return 0
    print(
        f"check: DIFFERENT, first in {different[0].place}; "
        f"{len(different)} of {len(found)} tensors:"
    )
    for one in different:
        print(f"  {one.place}")
    for operation, wrong in roundings.items():
        if wrong:
            print(f"note: {operation}: {wrong} of {conformance.COUNT} not as IEEE 754 rounds them")
    return 1


def read_hashes(path: Path) -> list[Fingerprint]:
    """Read a file of `clgs conformance -o`.

    Raises:
        DataError: the file is missing, too large, or another kind of file.
    """
    from clgs.errors import DataError
    from clgs.lab.selftest.conformance import from_record

    try:
        with path.open("rb") as file:
            text = file.read(LARGEST_RECORD + 1)
    except IsADirectoryError:
        raise DataError(f"{path}: is a folder; name the JSON file in it") from None
    except OSError as error:
        remedy = "`clgs conformance -o` makes one"
        raise DataError(f"{path}: {error.strerror}; {remedy}") from None
    if len(text) > LARGEST_RECORD:
        raise DataError(f"{path}: was not written by `clgs conformance -o`; name one that was")
    try:
        return from_record(json.loads(text))
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: is no JSON file; `clgs conformance -o` makes one") from error
    except DataError as error:
        raise DataError(f"{path}: {error}") from error
