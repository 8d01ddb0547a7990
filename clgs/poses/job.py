"""What every stage of a reconstruction needs to know."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

STAGES = (
    *("read", "features", "matches", "poses", "other poses", "second look", "more poses"),
    *("check", "undistort", "training"),
)
"""Of a reconstruction, in their order; not all are needed by each."""

OnProgress = Callable[[str, int, int], None]
"""Called with a stage, what of it is done, and of how much; 0 of 0 if that cannot be told."""

THREADS = os.cpu_count() or 1
"""Explicit, because pycolmap warns about memory if it may choose."""

LOCKED = "database factory"
"""What pycolmap says if it cannot open a database; it does not wait for one that is locked."""

WAITS = (0.1, 0.3, 1.0, 3.0)
"""Seconds: a connection may still be closing, or another mapper opening its own."""


@dataclass(frozen=True)
class Job:
    """One reconstruction.

    pycolmap: the module; images: folder of the photos; folder: for all that is made of them;
    names: of the files, in the order of the photos' own names; cameras: for each the number of its
    camera; seed: of all random choices; masks: folder of a mask per file, None without.
    """

    pycolmap: Any
    images: Path
    folder: Path
    names: list[str]
    cameras: list[int]
    seed: int
    on_progress: OnProgress
    masks: Path | None = None

    @property
    def database(self) -> Path:
        """Features, matches and two-view geometries."""
        return self.folder / "database.db"

    def open(self) -> Any:
        """pycolmap's connection to the database."""
        return self.call(self.pycolmap.Database.open, self.database)

    def call(self, function: Callable[..., Any], *args: Any, **options: Any) -> Any:
        """What a function of pycolmap that begins by opening a database returns.

        Raises:
            RuntimeError: the database could not be opened in all of WAITS, or another failure.
        """
        for wait in WAITS:
            try:
                return function(*args, **options)
            except RuntimeError as error:
                if LOCKED not in str(error):
                    raise
            time.sleep(wait)
        return function(*args, **options)

    def ids(self, database: Any) -> list[int]:
        """The number of each photo in the open ``database``, in the order of ``names``."""
        return [int(database.read_image_with_name(name).image_id) for name in self.names]
