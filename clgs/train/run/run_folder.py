"""The folder of a run: one process at a time works in it; what a finished run left there."""

from __future__ import annotations

import json
import os
import shutil
import weakref
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from clgs.codec.scene_decoder import decode
from clgs.data.dataset import Dataset
from clgs.data.origin import ORIGIN, read_origin
from clgs.errors import DataError, ExistsError, UsageError
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import load_scene
from clgs.train.config import TrainConfig, from_toml
from clgs.train.state.checkpoint import SETTINGS, changed_settings, checkpoints
from clgs.train.state.hashes import read_fingerprint, run_digest, scene_hash

RESULTS = "results.json"
"""The last file of a run: a folder that has it is finished."""

COARSE, BLOCKS, PLAN = "coarse", "blocks", "plan.json"
"""Folders of a run in blocks: the coarse scene, and the blocks; and the plan in these."""

FILES = (
    *("scene.clgs", "scene.npz", "progress.csv", "per_view.json", "hashes.json", "preview.png"),
    *("profile.json", "report.html", ORIGIN, RESULTS, SETTINGS),
)
"""What a run writes, except its folders and points; SETTINGS, by which it is known, comes last."""

SHOWN = {"split", "psnr", "ssim", "bytes", "anchors", "train_seconds", "digest"}
"""The fields of it that are read again."""


class FolderLock:
    """A lock that is held until :meth:`release`, or until the process ends in any way.

    Nothing is written. On Windows, and on file systems without locks, it has no effect.
    """

    def __init__(self, folder: Path) -> None:
        """Lock ``folder``, which exists.

        Raises:
            DataError: another process, or another lock of this one, holds it.
        """
        if os.name == "nt":
            return
        import fcntl

        opened = os.open(folder, os.O_RDONLY)
        self._close = weakref.finalize(self, os.close, opened)
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise DataError(
                f"{folder}: another process works in it; wait for it, or choose another folder"
            ) from None
        except OSError:
            self.release()

    def release(self) -> None:
        """Let others in."""
        if os.name != "nt":
            self._close()


@dataclass
class RunResult:
    """A finished run: its folder, the quantised scene, the bitstream and the summary."""

    folder: Path
    scene: QuantizedScene
    bitstream: bytes
    summary: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        """One line: the fields would be megabytes."""
        psnr = f", {self.summary['psnr']:.2f} dB" if "psnr" in self.summary else ""
        size = f"{len(self.bitstream):,} bytes, {len(self.scene.anchors):,} anchors"
        return f"<RunResult {self.folder}: {size}{psnr}>"


def finished_run(folder: Path, dataset: Dataset, config: TrainConfig) -> RunResult | None:
    """What the run in ``folder`` gave; None if there is none, or it is not finished.

    It must have been trained on ``dataset`` with the settings ``config``, resolved for that.

    Raises:
        DataError: its files are damaged.
        ExistsError: it is finished and had other settings or photos; a DataError, too.
    """
    if not (folder / RESULTS).exists():
        return None
    try:
        result = _read(folder)
        digest = result.summary["digest"]
    except (DataError, ValueError, TypeError, KeyError, RecursionError, FileNotFoundError) as error:
        raise DataError(
            f"{folder}: a finished run, but damaged ({error}); remove {RESULTS} and resume again "
            "to make its files again, or name another run folder"
        ) from error
    config = settings_for(dataset, config)
    if digest != run_digest(dataset, config):
        changed = changed_settings(folder, config)
        raise ExistsError(
            f"{folder}: holds a finished run with other settings or photos{changed}; give the same "
            "options (config.toml lists them) or choose another run folder, in which --from "
            f"{folder} trains this one further"
        )
    return result


def check_finished(folder: Path) -> None:
    """Raise DataError unless ``folder`` holds a finished run."""
    if not (folder / RESULTS).is_file():
        raise DataError(f"{folder}: holds no finished run; name one, or finish it by --resume")


def finished_settings(folder: Path) -> tuple[RunResult, TrainConfig]:
    """What the finished run in ``folder`` gave, and its settings.

    Raises:
        DataError: there is none, it is not finished, or its files are damaged.
    """
    check_finished(folder)
    try:
        text = (folder / SETTINGS).read_text(encoding="utf-8")
        return _read(folder), from_toml(text, str(folder / SETTINGS))
    except (ValueError, TypeError, KeyError, RecursionError, FileNotFoundError) as error:
        raise DataError(
            f"{folder}: a finished run, but damaged ({error}); restore its files or train it again"
        ) from error


def check_run_folder(folder: Path, resume: bool, overwrite: bool, in_blocks: bool = False) -> None:
    """Make sure that a run, perhaps in blocks, may go to ``folder``.

    Raises:
        ExistsError: it holds a run, which is neither to be resumed nor overwritten, or which is to
            be resumed but is in blocks where this one is not, or the other way round.
        UsageError: both are asked for.
        DataError: another process works in it.
    """
    if resume and overwrite:
        raise UsageError("--resume goes on with a run and --overwrite replaces it; give one")
    was_in_blocks = (folder / COARSE / SETTINGS).exists()
    if overwrite or not (was_in_blocks or (folder / SETTINGS).exists()):
        return
    if not resume:
        FolderLock(folder).release()
        raise ExistsError(
            f"{folder}: holds a run already; go on with it (--resume), replace it (--overwrite), "
            "or choose another folder"
        )
    if was_in_blocks != in_blocks:
        kind, remedy = ("in blocks", "add") if was_in_blocks else ("without blocks", "leave out")
        raise ExistsError(
            f"{folder}: holds a run {kind}; {remedy} --blocks to go on with it, or choose another "
            "folder"
        )


def check_same_data(folder: Path, data: Path) -> None:
    """Make sure that the run in ``folder``, if there is one, is of the data set ``data``.

    A data set that is not where it was any more may be this one.

    Raises:
        ExistsError: it is of another one; a DataError, too.
    """
    origin = read_origin(folder)
    if not origin or not origin.folder.is_dir():
        return
    if data.resolve() not in (place.resolve() for place in origin.places):
        raise ExistsError(
            f"{folder}: holds a run of {origin.folder}; name that, or another run folder"
        )


def remove_run(folder: Path) -> None:
    """Remove the files of a run, but not the points that it triangulated, nor anything else.

    Of a run in blocks, these and its coarse scene go, too.
    """
    if (folder / COARSE / SETTINGS).exists():
        if (folder / BLOCKS / PLAN).is_file():
            shutil.rmtree(folder / BLOCKS)
        remove_run(folder / COARSE)
    if not (folder / SETTINGS).exists():
        return
    for path in (folder / "test").glob("ours_*"):
        shutil.rmtree(path)
    for path in (*(folder / name for name in FILES), *checkpoints(folder / "checkpoint")):
        path.unlink(missing_ok=True)


def settings_for(dataset: Dataset, config: TrainConfig) -> TrainConfig:
    """The settings with the size that the dataset's photos have."""
    times, max_size = dataset.reduction.times, dataset.reduction.max_size
    return replace(config, downscale=times, max_size=max_size)


def _read(folder: Path) -> RunResult:
    """The files of a finished run; raises if one is missing, damaged, or not of this run."""
    summary = json.loads((folder / RESULTS).read_text(encoding="utf-8"))
    if lacking := SHOWN - set(summary):
        raise ValueError(f"{RESULTS} lacks {', '.join(sorted(lacking))}")
    bitstream = (folder / "scene.clgs").read_bytes()
    if len(bitstream) != summary["bytes"]:
        raise ValueError(f"scene.clgs has {len(bitstream)} bytes, not {summary['bytes']}")
    expected = read_fingerprint(folder / "hashes.json")["scene"]
    scene = load_scene(folder / "scene.npz")
    for name, found in (("scene.clgs", decode(bitstream)), ("scene.npz", scene)):
        if scene_hash(found) != expected:
            raise ValueError(f"{name} and hashes.json differ")
    return RunResult(folder, scene, bitstream, summary)
