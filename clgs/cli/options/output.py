"""What a command writes: the option --overwrite, and the one rule of what may be replaced."""

from __future__ import annotations

import argparse
from pathlib import Path

RUN_FILES = ("config.toml", "plan.json")
"""What the folders that `clgs train` and `clgs run` make are known by."""


def add_overwrite(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --overwrite; ``what`` it replaces, in words."""
    parser.add_argument("--overwrite", action="store_true", help=f"replace {what}")


def check_new(args: argparse.Namespace, path: Path, *sources: Path) -> None:
    """Refuse, before long work, an output that cannot be written, is read, or exists already.

    Raises:
        ExistsError: there is such a file, and --overwrite was not given.
        UsageError: ``path`` is one of ``sources``.
        OutputError: as of :func:`clgs.files.check_target`.
    """
    from clgs.errors import ExistsError
    from clgs.files import check_output

    check_output(path, *sources)
    if path.exists() and not args.overwrite:
        raise ExistsError(f"{path}: exists already; add --overwrite or choose another name")


def holds_run(folder: Path) -> bool:
    """Whether `clgs train` or `clgs run` made ``folder``, finished or not."""
    return any((folder / name).is_file() for name in RUN_FILES)


def check_picture_folder(output: Path) -> None:
    """Refuse, before long work, a folder that cannot receive pictures, or should not.

    Raises:
        UsageError: it is named like a picture, or holds a run.
        OutputError: as of :func:`clgs.files.check_folder`.
    """
    from clgs.data.images import SUFFIXES
    from clgs.errors import UsageError
    from clgs.files import check_folder

    check_folder(output)
    if output.suffix.lower() in SUFFIXES and not output.is_dir():
        raise UsageError(f"{output}: pictures go into a folder; name one, such as {output.stem}")
    if holds_run(output):
        raise UsageError(f"{output}: holds a run; name another folder, such as {output / 'views'}")


def check_suffix(output: Path, suffix: str) -> None:
    """Refuse to write a file under the name of another kind.

    Raises:
        UsageError: the name does not end in ``suffix``.
    """
    from clgs.errors import UsageError

    if output.suffix.lower() != suffix:
        raise UsageError(f"{output}: the output is a {suffix} file; name it so")
