"""``clgs export``: what clgs knows, in a file that other programs open; the suffix says which."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path
from typing import Any

from clgs.cli.options.output import add_overwrite, check_new
from clgs.cli.options.view import named_path

KINDS = {
    ".glb": "glb",
    ".html": "page",
    ".ply": "baked",
    ".spz": "baked",
    ".sog": "baked",
}
"""Suffix of the output to the module of ``clgs.cli.exports`` that writes it.

Each has ``HELP``, a line, ``add_options(parser)`` and ``run(args)``, which prints a line.
"""

DESCRIPTION = """\
Write what other programs open; the suffix of FILE says what:

"""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    lines = "\n".join(f"  {_suffixes(name)} {_module(name).HELP}" for name in _modules())
    parser.description = DESCRIPTION + lines
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
    parser.add_argument(
        "--data",
        type=Path,
        help="the data set that SCENE was made of (default: that which its run folder names)",
    )
    for name in _modules():
        _module(name).add_options(parser)
    add_overwrite(parser, "the file if it exists (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Write the file and print one line; exit code 0."""
    from clgs.cli.options.view import known_data
    from clgs.errors import UsageError

    name = KINDS.get(args.output.suffix.lower())
    if name is None:
        known = ", ".join(KINDS)
        raise UsageError(f"{args.output}: nothing is written by this suffix; take one of {known}")
    check_new(args, args.output)
    if args.data is None and args.source is not None:
        args.data = known_data(args.source)
    _module(name).run(args)
    return 0


def _modules() -> list[str]:
    """The modules, each once."""
    return list(dict.fromkeys(KINDS.values()))


def _suffixes(name: str) -> str:
    """What the module writes, at least 6 characters wide."""
    return f"{' '.join(suffix for suffix, own in KINDS.items() if own == name):6}"


def _module(name: str) -> Any:
    return importlib.import_module(f"clgs.cli.exports.{name}")
