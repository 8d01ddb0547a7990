"""Finished pieces of a reconstruction: what takes long is done once, also if processes are killed.

All other steps are repeated by the next process, with the same results.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.files import atomic_folder, atomic_write, write_json

_FEATURES, _SECONDS = "features", ".seconds.json"


class Finished:
    """The pieces in a folder, each of them complete or not there.

    The features of a photo are a file. Any other piece is a folder, found again by the number of
    pieces before it and the name of its stage.
    """

    def __init__(self, folder: Path) -> None:
        """Take up what is in ``folder``."""
        self._folder, self._count = folder, 0
        self._seconds_file = folder / _SECONDS
        self._seconds = dict[str, float]()
        if self._seconds_file.is_file():
            self._seconds = json.loads(self._seconds_file.read_text(encoding="utf-8"))
        self._stage, self._began = "", time.perf_counter()

    def summary(self) -> str:
        """Say what is there already, in a line; empty if nothing is."""
        photos = len(list((self._folder / _FEATURES).glob("[0-9]*")))
        stages = sorted(path.name for path in self._folder.glob("[0-9]*"))
        names = dict.fromkeys(name.partition(" ")[2] for name in stages)
        parts = [f"features of {photos} photos"] * bool(photos) + list(names)
        return f"{', '.join(parts)} are there already" if parts else ""

    def piece(self, stage: str, make: Callable[[Path], None]) -> Path:
        """The folder of the next piece, which is there, or is filled by ``make`` now."""
        self._count += 1
        path = self._folder / f"{self._count:02d} {stage}"
        if not path.is_dir():
            with atomic_folder(path) as new:
                make(new)
            self.seconds()
        return path

    def part(self, name: str) -> Finished:
        """The pieces of work that goes on at the same time, counted by themselves."""
        folder = self._folder / name
        folder.mkdir(exist_ok=True)
        return Finished(folder)

    def features(self, photo: str) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]] | None:
        """Read keypoints (N, 6) and descriptors (N, 128) of a photo; None if they are not there."""
        path = self._features_path(photo)
        if not path.is_file():
            return None
        with np.load(path, allow_pickle=False) as found:
            return found["keypoints"], found["descriptors"]

    def keep_features(
        self, photo: str, keypoints: npt.NDArray[np.float32], descriptors: npt.NDArray[np.uint8]
    ) -> None:
        """Keep what :meth:`features` reads."""
        path, buffer = self._features_path(photo), io.BytesIO()
        np.savez(buffer, keypoints=keypoints, descriptors=descriptors)
        path.parent.mkdir(exist_ok=True)
        atomic_write(path, buffer.getvalue())

    def _features_path(self, photo: str) -> Path:
        return self._folder / _FEATURES / f"{photo}.npz"

    def begin(self, stage: str) -> None:
        """Note that a stage begins, or goes on."""
        self._spend()
        self._stage = stage

    def seconds(self) -> dict[str, float]:
        """The seconds of each stage until now, with those of processes that were killed."""
        self._spend()
        write_json(self._seconds_file, self._seconds)
        return {stage: round(seconds, 1) for stage, seconds in self._seconds.items()}

    def _spend(self) -> None:
        now = time.perf_counter()
        if self._stage:
            self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + now - self._began
        self._began = now
