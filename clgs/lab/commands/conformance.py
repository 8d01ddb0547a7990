"""`clgs conformance`: hashes of renders and gradients of fixed scenes, to compare devices by."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clgs.cli.shared_options import named_path

if TYPE_CHECKING:
    from clgs.lab.selftest.conformance import Fingerprint

DESCRIPTION = """\
SHA-256 of every tensor that the kernels compute for fixed scenes: renders, gradients and all stages
in between. With --check: whether another device made the same bits, without a FILE the CPU that
these hashes were made on; names the first stage that did not. Both forms of the kernels, for CPUs
and for GPUs, make the same bits if a device rounds as IEEE 754 does. Exit code 1 if any tensor
differs."""

SHIPPED = Path(__file__).parents[1] / "selftest" / "conformance.json"
"""Made by PoCL 3.1 on a CPU."""

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


def run(args: argparse.Namespace) -> int:
    """Compute, write and compare; exit code 0, or 1 if a tensor differs."""
    from clgs.errors import DataError
    from clgs.files import check_target, write_json
    from clgs.lab.facts import machine_facts
    from clgs.lab.selftest import conformance
    from clgs.opencl.device import Device

    if args.output:
        check_target(args.output)
    wanted = _tensors(args.check, _read(args.check)) if args.check else []
    device = Device(args.device)
    found, roundings = conformance.fingerprints(device), conformance.roundings(device)
    facts = machine_facts(device) | {"wrongly_rounded": roundings}
    print(f"{device.name} ({device.specialisation}): {len(found)} tensors, together {_all(found)}")
    if args.output:
        write_json(args.output, conformance.to_record(found, facts))
    if args.check is None:
        return 0
    try:
        different = conformance.differences(found, wanted)
    except DataError as error:
        raise DataError(f"{args.check}: {error}") from error
    _report(different, len(found))
    for operation, wrong in roundings.items():
        if different and wrong:
            print(f"note: {operation}: {wrong} of {conformance.COUNT} not as IEEE 754 rounds them")
    return 1 if different else 0


def _read(path: Path) -> Any:
    from clgs.errors import DataError

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
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: is no JSON file; `clgs conformance -o` makes one") from error


def _tensors(path: Path, record: object) -> list[Fingerprint]:
    from clgs.errors import DataError
    from clgs.lab.selftest.conformance import from_record

    try:
        return from_record(record)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def _all(found: list[Fingerprint]) -> str:
    """One hash of all tensors."""
    import hashlib

    return hashlib.sha256("".join(one.sha256 for one in found).encode()).hexdigest()[:16]


def _report(different: list[Fingerprint], count: int) -> None:
    if not different:
        print(f"check: all {count} tensors are bit-identical")
        return
    print(f"check: DIFFERENT, first in {different[0].place}; {len(different)} of {count} tensors:")
    for one in different:
        print(f"  {one.place}")
