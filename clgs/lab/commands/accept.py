"""`clgs accept`: everything that shows how clgs does on a device, in one file for its makers."""

from __future__ import annotations

import argparse
from pathlib import Path

from clgs.cli.options import add_overwrite, positive_int
from clgs.errors import UsageError


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = (
        "Checks of every kernel, hashes, training, start-up and speed of every stage on one "
        "device, each in a process of its own: a crash ends one part. Minutes, without a "
        "network. Prints a table and writes every figure to FILE, part by part. Exit code 1 "
        "if a part failed."
    )
    add = parser.add_argument
    add("-o", "--output", type=Path, metavar="FILE", required=True, help="receives all figures")
    add("--device", help="number or part of the name, see `clgs devices`")
    add("--data", type=Path, metavar="DATA", help="train 1,000 steps on this data set, too")
    add("--downscale", type=positive_int, metavar="N", help="of its photos, as for `clgs train`")
    add("--quick", action="store_true", help="a tenth of the work")
    add_overwrite(parser, "FILE if it exists (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Run all parts; exit code 0, or 1 if one failed.

    Raises:
        ClgsError: FILE exists, DATA is no data set, or there is no device.
        UsageError: ``--downscale`` without DATA, or a variable of the environment is wrong.
    """
    from tempfile import TemporaryDirectory

    from clgs.data.dataset import read_photo_set
    from clgs.lab.trials import QUICK, WHOLE, chosen_device, run_trials, trials, write_photos
    from clgs.opencl.choose import wanted_form, wanted_lanes
    from clgs.workflow.outputs import check_new

    wanted_form(), wanted_lanes()  # errors come before the trials
    if args.downscale and args.data is None:
        raise UsageError("--downscale: is of the photos of --data, which is not given")
    check_new(args.output, args.overwrite)
    data = []
    if args.data is not None:
        read_photo_set(args.data)
        data = [str(args.data.resolve()), "--steps", "1000"]
        data += ["--downscale", str(args.downscale)] if args.downscale else []
    with TemporaryDirectory(prefix="clgs-accept-") as name:
        folder = Path(name)
        device = chosen_device(args.device, folder)
        write_photos(folder / "photos")
        size = QUICK if args.quick else WHOLE
        todo = trials(str(device["index"]), folder, size, data)
        try:
            outcomes = run_trials(todo, folder, device, args.output)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"; {args.output} has the parts that ended") from None
    print(f"{device['name']} ({device['platform']}, driver {device['driver']})")
    for one in outcomes:
        verdict = "ok" if one.passed else "FAIL"
        print(f"  {one.name:<18} {verdict:<5} {one.seconds:7.1f} s  {one.summary}")
    failed = sum(not one.passed for one in outcomes)
    print(f"{args.output}: {failed} of {len(outcomes)} parts failed")
    return 1 if failed else 0
