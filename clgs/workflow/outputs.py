"""The one rule of what a command may write and replace, checked before long work."""

from __future__ import annotations

from pathlib import Path

from clgs.data.images import SUFFIXES, list_images
from clgs.errors import ExistsError, UsageError
from clgs.files import check_folder, check_output

RUN_FILES = ("config.toml", "plan.json")
"""Files by which the folders that `clgs train` and `clgs run` make are recognised."""


def check_new(path: Path, overwrite: bool, *sources: Path) -> None:
    """Refuse an output that cannot be written, is read, or exists already.

    Raises:
        ExistsError: there is such a file, and ``overwrite`` is false.
        UsageError: ``path`` is one of ``sources``.
        OutputError: :func:`clgs.files.check_target` refuses it.
    """
    check_output(path, *sources)
    if path.exists() and not overwrite:
        raise ExistsError(f"{path}: exists already; add --overwrite or choose another name")


def check_suffix(output: Path, suffix: str) -> None:
    """Raise UsageError if the name of ``output`` does not end in ``suffix``."""
    if output.suffix.lower() != suffix:
        raise UsageError(f"{output}: the output is a {suffix} file; name it so")


def holds_run(folder: Path) -> bool:
    """Whether `clgs train` or `clgs run` made ``folder``, finished or not."""
    return any((folder / name).is_file() for name in RUN_FILES)


def check_picture_folder(output: Path) -> None:
    """Refuse a folder that cannot receive pictures, or should not.

    Raises:
        UsageError: it is named like a picture, or holds a run.
        OutputError: :func:`clgs.files.check_folder` refuses it.
    """
    check_folder(output)
    if output.suffix.lower() in SUFFIXES and not output.is_dir():
        raise UsageError(f"{output}: pictures go into a folder; name one, such as {output.stem}")
    if holds_run(output):
        raise UsageError(f"{output}: holds a run; name another folder, such as {output / 'views'}")


def check_apart(output: Path, data: Path) -> None:
    """Refuse an output folder whose files would mix with the photos of a data set.

    Raises:
        UsageError: ``output`` is ``data``, or a folder in it that holds photos and no run.
    """
    if not (output.is_dir() and data.is_dir()):
        return
    own, folder = output.resolve(), data.resolve()
    inside = folder in own.parents and not (own / "config.toml").exists()
    if own == folder or (inside and list_images(own)):
        raise UsageError(f"{output}: is the folder of the photos; name another with -o")
