"""Options that the commands of the codec share."""

from __future__ import annotations

import argparse
import math

from clgs.cli.options.view import add_overwrite, named_path


def add_files(parser: argparse.ArgumentParser, name: str, source: str, output: str) -> None:
    """Add the argument ``name``, --output, shown as ``source`` and ``output``, and --overwrite.

    The command must pass both files to ``clgs.workflow.outputs.check_new``.
    """
    parser.add_argument(name, type=named_path, metavar=source)
    parser.add_argument("-o", "--output", type=named_path, required=True, metavar=output)
    add_overwrite(parser, "the output if it exists (default: refuse)")


def add_level(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--level``, which the encoder checks."""
    parser.add_argument("--level", default="default", help="fast, default, max or paper")


def add_threads(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--threads``."""
    parser.add_argument("--threads", type=int, metavar="N", help="default: one per processor")


def in_range(text: str) -> float:
    """An argument that must be a step, or integers per unit, in the range that a file can hold."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 2.0**-64 <= value <= 2.0**64:
        raise argparse.ArgumentTypeError(
            f"{text} is not a number from 2^-64 to 2^64 (5.5e-20 to 1.8e19)"
        )
    return value
