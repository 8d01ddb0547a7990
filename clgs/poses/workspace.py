"""The folder, the database and the options that all stages of a reconstruction share."""

from __future__ import annotations

import json
import os
import sqlite3
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.posed_photo import Photo
from clgs.opencl.device import Device
from clgs.poses.unfinished import Finished

STAGES = (
    *("read", "features", "looks", "matches", "all features", "geometry"),
    *("poses", "other poses", "second look"),
    *("more poses", "check", "points", "undistort", "masks", "report"),
)
"""The stages of ``prepare`` in order; some reconstructions skip some of them."""

OnProgress = Callable[[str, int, int], None]
"""A function of a stage's name, the finished amount and the total; 0 of 0 if both are unknown."""

THREADS = os.cpu_count() or 1
"""Given to pycolmap because it warns about memory if it may choose."""

LOCKED = "database factory"
"""Part of pycolmap's message if it cannot open a database; it does not wait for a lock to end."""

WAITS = (0.1, 0.3, 1.0, 3.0)
"""Seconds between attempts: another connection may be closing or opening."""

_TABLES = ("matches", "two_view_geometries")
_PAIRS, _RESULT = "pairs.db", "result.json"
"""Files of a finished piece: these tables of the database, and what its maker returned."""


@dataclass(frozen=True)
class Workspace:
    """The inputs of one reconstruction, and the folder of its files.

    pycolmap: the module; device: which matches features; images: folder of the photos; folder: for
    all files that are made; names: the photos' file names, in order; cameras: the camera's number
    of each photo; seed: of all random choices; masks: of those that have one, NAME.png, None
    without; known: photos with a given pose, by file name, their lenses at the size of the file;
    positions: (3,) metres east, north and up by GPS, by file name; finished: what earlier processes
    made, None if nothing is kept.
    """

    pycolmap: Any
    device: Device
    images: Path
    folder: Path
    names: list[str]
    cameras: list[int]
    seed: int
    on_progress: OnProgress
    masks: Path | None = None
    known: Mapping[str, Photo] = field(default_factory=dict)
    positions: Mapping[str, npt.NDArray[np.float64]] = field(default_factory=dict)
    finished: Finished | None = None

    @property
    def database(self) -> Path:
        """The path of the database: features, matches and two-view geometries."""
        return self.folder / "database.db"

    def open(self) -> Any:
        """Open the database; returns pycolmap's connection."""
        return self.call(self.pycolmap.Database.open, self.database)

    @staticmethod
    def call(function: Callable[..., Any], *args: Any, **options: Any) -> Any:
        """Call a function of pycolmap that begins by opening a database; returns its result.

        Raises:
            RuntimeError: the database stayed locked for all of WAITS, or another failure.
        """
        for wait in WAITS:
            try:
                return function(*args, **options)
            except RuntimeError as error:
                if LOCKED not in str(error):
                    raise
            time.sleep(wait)
        return function(*args, **options)

    def counter(self, stage: str, done: int, total: int) -> Callable[[int], None]:
        """Report that ``done`` of a stage is finished; returns a function of how much more is.

        Several threads may call that.
        """
        one_at_a_time = threading.Lock()

        def count(more: int) -> None:
            nonlocal done
            with one_at_a_time:
                done = min(done + more, total)
                self.on_progress(stage, done, total)

        count(0)
        return count

    def pipeline_options(self) -> Any:
        """Make options of COLMAP's incremental pipeline: the seed, and one thread."""
        options = self.pycolmap.IncrementalPipelineOptions()
        options.num_threads = options.mapper.num_threads = 1
        options.random_seed = options.mapper.random_seed = self.seed
        options.triangulation.random_seed = self.seed
        return options

    def ids(self, database: Any) -> list[int]:
        """Read each photo's number in the open ``database``, in the order of ``names``."""
        return [int(database.read_image_with_name(name).image_id) for name in self.names]

    def models(self, stage: str, make: Callable[[], list[Any]]) -> list[Any]:
        """Make reconstructions, unless they are finished; those that are kept come from files."""
        if self.finished is None:
            return make()

        def write(folder: Path) -> None:
            self.pycolmap.set_random_seed(self.seed)
            for number, model in enumerate(make()):
                (folder / str(number)).mkdir()
                model.write(folder / str(number))

        folder = self.finished.piece(stage, write)
        made = len(list(folder.iterdir()))
        return [self.pycolmap.Reconstruction(folder / str(number)) for number in range(made)]

    def matches(self, stage: str, make: Callable[[], Any]) -> Any:
        """Change matches and geometries in the database, unless that is finished.

        Returns:
            What ``make`` returned; it can be JSON.
        """
        if self.finished is None:
            return make()

        def write(folder: Path) -> None:
            self.pycolmap.set_random_seed(self.seed)
            result = make()
            with closing(sqlite3.connect(self.database)) as database, database:
                database.execute("ATTACH ? AS kept", (str(folder / _PAIRS),))
                for table in _TABLES:
                    database.execute(f"CREATE TABLE kept.{table} AS SELECT * FROM main.{table}")
            (folder / _RESULT).write_text(json.dumps(result), encoding="utf-8")

        folder = self.finished.piece(stage, write)
        with closing(sqlite3.connect(self.database)) as database, database:
            database.execute("ATTACH ? AS kept", (str(folder / _PAIRS),))
            for table in _TABLES:
                database.execute(f"DELETE FROM main.{table}")
                database.execute(f"INSERT INTO main.{table} SELECT * FROM kept.{table}")
        return json.loads((folder / _RESULT).read_text(encoding="utf-8"))
