"""What a ``prepare`` that has not ended leaves, so that the next one goes on from it.

Of its hidden folders, the one that becomes the data set goes if its process is killed. The other
one stays, with the finished pieces of the work, for the next process that is given the same photos
and options: what takes long is done once. All other steps are repeated, with the same results.
"""

from __future__ import annotations

import glob
import hashlib
import importlib.metadata
import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from clgs import __version__
from clgs.errors import DataError
from clgs.files import STEM_KEPT, atomic_folder, atomic_write, write_json
from clgs.poses.pycolmap_child import CrashError

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
        photos = len(list((self._folder / _FEATURES).glob("[!.]*")))
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


OWNER = "owner"
"""A file in the folder work/ of an unfinished data set; the running process holds a lock on it."""

_LOCK = ".owner"
"""The same in a folder of finished pieces, whose names begin with no dot."""

HINT = "what was finished is kept; the same command goes on from there"

_GUARD = """
import os, shutil, sys, time

def nothing_is_finished(kept):
    return all(name.startswith(".") for name in os.listdir(kept))

def remove(kept):
    if os.name == "nt":
        shutil.rmtree(kept, ignore_errors=True)
        return
    import fcntl
    with open(os.path.join(kept, ".owner"), "rb") as owner:
        fcntl.flock(owner, fcntl.LOCK_EX | fcntl.LOCK_NB)  # fails if the next command has it
        if nothing_is_finished(kept):
            shutil.rmtree(kept, ignore_errors=True)

if not sys.stdin.buffer.read():
    for _ in range(50):  # children of the killed process may write for a moment more
        shutil.rmtree(sys.argv[1], ignore_errors=True)
        for kept in sys.argv[2:]:
            try:
                if nothing_is_finished(kept):
                    remove(kept)
            except OSError:
                pass
        time.sleep(0.1)
"""

_MOMENT, _MOMENTS = 0.05, 4
"""Seconds between attempts to lock, and how many: a guard locks for a moment only."""


@contextmanager
def removed_if_killed(folder: Path, kept: Path | None = None) -> Iterator[None]:
    """Remove ``folder`` and all that it holds if this process is killed within the block.

    A killed process cannot do that, so another process waits for its end. The folder ``kept`` goes,
    too, if nothing in it is finished.
    """
    with subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", _GUARD, str(folder), *([str(kept)] if kept else [])],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # so that it survives what ends all processes of a terminal
    ) as guard:
        try:
            yield
        finally:
            with suppress(BrokenPipeError):
                guard.communicate(b"done")


@contextmanager
def owned(work: Path) -> Iterator[None]:
    """Make the folder ``work`` and show other processes that it is in use within the block."""
    work.mkdir()
    with (work / OWNER).open("wb") as file:
        _has_lock(file)
        yield


def remove_leftovers(output: Path) -> None:
    """Remove the hidden folders that killed runs with the same ``output`` left next to it."""
    name = rf"\.{re.escape(output.stem[:STEM_KEPT])}\.[0-9a-f]{{18}}{re.escape(output.suffix)}"
    for folder in output.parent.iterdir():
        if re.fullmatch(name, folder.name) and _is_left(folder / "work" / OWNER):
            shutil.rmtree(folder, ignore_errors=True)


def _is_left(owner: Path) -> bool:
    """Whether a file OWNER is there, and no running process holds its lock."""
    with suppress(OSError), owner.open("rb") as file:
        return _has_lock(file, shared=True) is True
    return False


def _has_lock(file: BinaryIO, shared: bool = False) -> bool | None:
    """Lock an open file; whether that went well, None if the system has no locks here."""
    if os.name == "nt":
        return None
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_NB | (fcntl.LOCK_SH if shared else fcntl.LOCK_EX))
    except OSError as error:
        return False if isinstance(error, BlockingIOError) else None
    return True


def digest_of(files: Iterable[Path], options: Any) -> str:
    """Compute what finished pieces depend on: 16 hexadecimal digits.

    Args:
        files: that are read; they count by name, size and time of their last change.
        options: as JSON can hold them.
    """
    stats = [(path.name, path.stat()) for path in files]
    listed = [(name, stat.st_size, stat.st_mtime_ns) for name, stat in stats]
    programs = [__version__]
    for name in ("pycolmap", "opencv-python-headless"):
        with suppress(importlib.metadata.PackageNotFoundError):
            programs.append(importlib.metadata.version(name))
    digest = hashlib.blake2b(json.dumps([listed, options, programs]).encode(), digest_size=8)
    for module in sorted(Path(__file__).parent.rglob("*.py")):  # of a version that is changed
        digest.update(module.read_bytes())
    return digest.hexdigest()


def _lock(folder: Path) -> BinaryIO | None:
    """Make ``folder``, and lock it until the file is closed; None if another process has it.

    The guard of a killed process locks it for a moment, and may remove it: then it is made again.
    """
    for _ in range(_MOMENTS):
        folder.mkdir(exist_ok=True)
        with suppress(FileNotFoundError), ExitStack() as closing:
            file = closing.enter_context((folder / _LOCK).open("wb"))
            held = _has_lock(file)
            if held is None or (held and os.fstat(file.fileno()).st_nlink):  # it is still there
                closing.pop_all()
                return file
        time.sleep(_MOMENT)
    return None


@contextmanager
def kept_pieces(output: Path, digest: str) -> Iterator[Path | None]:
    """A folder next to ``output`` for finished pieces; those of an earlier call are in it.

    Those of another ``digest`` are removed. The folder goes once the block is done, or knows what
    is wrong with the photos. It stays if this process or a child of it is killed, and at any other
    error, if something is finished. Within the block it belongs to this process; None if it
    belongs to another.
    """
    prefix = f".{output.name[:STEM_KEPT]}.unfinished-"
    folder = output.parent / f"{prefix}{digest}"
    for other in output.parent.glob(f"{glob.escape(prefix)}*"):
        if other != folder and (os.name == "nt" or _is_left(other / _LOCK)):
            shutil.rmtree(other, ignore_errors=True)
    file = _lock(folder)
    if file is None:
        yield None
        return
    with file:
        for broken in folder.glob(".[!o]*"):
            shutil.rmtree(broken, ignore_errors=True)
        stays = False
        try:
            yield folder
        except BaseException as error:
            finished = any(not path.name.startswith(".") for path in folder.iterdir())
            stays = finished and (isinstance(error, CrashError) or not isinstance(error, DataError))
            if stays:
                error.add_note(HINT)
            raise
        finally:
            if not stays:
                shutil.rmtree(folder, ignore_errors=True)
