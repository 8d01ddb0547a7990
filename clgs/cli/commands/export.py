"""``clgs export``: what clgs knows, in a file that other programs open; the suffix says which."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path
from typing import Any

from clgs.cli.options.output import add_overwrite, check_new
from clgs.cli.options.view import named_path

KINDS = {
    ".glb": "cameras",
    ".html": "page",
}
"""Suffix of the output to the module of ``clgs.cli.exports`` that writes it.

Each has ``HELP``, a line, ``add_options(parser)`` and ``run(args)``, which prints a line.
"""

DESCRIPTION = """\
Write what other programs open; the suffix of FILE says what:

"""


def register(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command and its options."""
    lines = "\n".join(f"  {suffix:6} {_module(name).HELP}" for suffix, name in KINDS.items())
    parser = subparsers.add_parser(
        "export",
        help="write cameras, or a scene as a web page, for other programs",
        description=DESCRIPTION + lines,
    )
    parser.add_argument(
        "source",
        type=Path,
        nargs="?",
        metavar="SCENE|DATA",
        help="a run folder or .clgs file, or a data set, as FILE needs",
    )
    parser.add_argument(
        "-o", "--output", type=named_path, required=True, metavar="FILE", help="new file"
    )
    for name in dict.fromkeys(KINDS.values()):
        _module(name).add_options(parser)
    add_overwrite(parser, "the file if it exists (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Write the file and print one line; exit code 0."""
    from clgs.errors import UsageError

    name = KINDS.get(args.output.suffix.lower())
    if name is None:
        known = ", ".join(KINDS)
        raise UsageError(f"{args.output}: nothing is written by this suffix; take one of {known}")
    check_new(args, args.output)
    _module(name).run(args)
    return 0


def _module(name: str) -> Any:
    return importlib.import_module(f"clgs.cli.exports.{name}")
