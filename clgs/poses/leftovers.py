"""Hidden folders of runs that were killed: told from those of runs that still work, and removed."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clgs.files import STEM_KEPT

OWNER = "owner"
"""A file that a running process holds locked, in the folder work/ of what it makes."""


@contextmanager
def owned(work: Path) -> Iterator[None]:
    """Within the block the folder ``work`` (made here) tells other processes that it is in use."""
    work.mkdir()
    with (work / OWNER).open("wb") as file:
        if os.name != "nt":
            import fcntl

            with suppress(OSError):  # a file system without locks
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield


def remove_leftovers(output: Path) -> None:
    """Remove what killed runs with the same ``output`` left beside it."""
    if os.name == "nt" or not output.parent.is_dir():
        return
    name = rf"\.{re.escape(output.stem[:STEM_KEPT])}\.[0-9a-f]{{8}}{re.escape(output.suffix)}"
    for folder in output.parent.iterdir():
        if re.fullmatch(name, folder.name) and _abandoned(folder / "work" / OWNER):
            shutil.rmtree(folder, ignore_errors=True)


def _abandoned(owner: Path) -> bool:
    import fcntl

    try:
        with owner.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:  # there is none, or it is locked
        return False
    return True
