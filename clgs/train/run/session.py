"""A whole training run in a run folder: log, checkpoints, results; it can be resumed."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from clgs.arguments import as_path, check_type
from clgs.codec.scene_encoder import encode
from clgs.data.dataset import Dataset
from clgs.data.origin import repose, same_place, write_origin
from clgs.data.view import View
from clgs.errors import DataError, UsageError
from clgs.exports.pictures import PictureFolder
from clgs.files import atomic_write, make_folder, write_json
from clgs.machine import interruptions, peak_memory
from clgs.opencl.device import Device
from clgs.render.renderer import Renderer
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import save_scene
from clgs.train.config import TrainConfig
from clgs.train.quality.rate_control import MAX_VIEWS, SceneJudge, reduce_to_size, spread
from clgs.train.quality.scores import evaluate_views, mean_psnr, summarize
from clgs.train.rate.rate_term import estimated_bytes
from clgs.train.run.load import state_of_run, with_points
from clgs.train.run.progress import Keeper, ProgressLog
from clgs.train.run.run_folder import (
    RESULTS,
    FolderLock,
    RunResult,
    check_run_folder,
    finished_run,
    finished_settings,
    remove_run,
    settings_for,
)
from clgs.train.run.trainer import StepResult, Trainer
from clgs.train.state.checkpoint import checkpoints
from clgs.train.state.hashes import fingerprint, run_digest
from clgs.train.state.run_state import RunState
from clgs.train.step.batch import check_together

_log = logging.getLogger(__name__)

HASHED_VIEWS = 3
TRAINING_VIEWS = 16
"""The most training views that are scored at the end."""


@dataclass
class Progress:
    """What a progress display shows: the last step, PSNR on fixed views, estimated bytes."""

    result: StepResult
    psnr: float | None = None
    estimated_bytes: int | None = None


class Session:
    """Trains in ``folder``; call :meth:`run` once."""

    def __init__(
        self,
        dataset: Dataset,
        folder: Path,
        config: TrainConfig,
        device: Device,
        resume: bool,
        first: Callable[[TrainConfig], RunState] | None = None,
        others: Sequence[Device] = (),
        lock: FolderLock | None = None,
    ) -> None:
        """Prepare a new run, in place of one in ``folder``, or the continuation of one.

        ``first``: gives the state that a new run begins with, for its settings; without it the run
        begins with the points of ``dataset``. ``others``: devices that look at views of a batch
        next to ``device``, which has the state of the run. ``lock``: of ``folder``, which the
        caller holds and releases; without it the folder is locked until the run ends.

        Raises:
            UsageError: a batch has more views than there are training photos.
            DataError: there is nothing to train on, the checkpoints are of another run, or another
                process trains into ``folder``.
            BudgetError: the memory budget is too small for some view; nothing is written then.
        """
        if not dataset.train:
            raise DataError("the dataset has no training views; check the folder of images")
        config = replace(settings_for(dataset, config), points=dataset.points_file)
        self.folder, self.config, self.device = folder, config, device
        self._names = [each.name for each in (device, *others)]
        self.dataset = dataset
        self._is_locked_by_caller = lock is not None
        if lock is None and folder.is_dir():
            lock = FolderLock(folder)
        goes_on = resume and bool(checkpoints(folder / "checkpoint"))
        state = None if first is None or goes_on else first(config)
        self.trainer = Trainer(device, dataset, config, state=state, others=others)
        if goes_on:
            self.trainer.resume(folder / "checkpoint")
        self.keeper = Keeper(folder, self.trainer)
        self.trainer.check_budget()
        make_folder(folder)
        self._lock = lock or FolderLock(folder)
        if not resume:
            remove_run(folder)
        (folder / RESULTS).unlink(missing_ok=True)
        atomic_write(folder / "config.toml", config.to_toml().encode())
        write_origin(folder, dataset)
        self.log = ProgressLog(folder / "progress.csv", self.trainer.steps_done)

    def run(self, on_progress: Callable[[Progress], None] | None = None) -> RunResult:
        """Train to the end, then quantise, encode, render and score the held-out views.

        On Ctrl-C or SIGTERM the current step is finished, a checkpoint is written, and
        KeyboardInterrupt is raised; a second Ctrl-C does not wait. On a full disk training goes
        on; at the end it waits for room if otherwise steps would be lost.

        Raises:
            FullDiskError: there is no room; the newest checkpoint is whole.
        """
        try:
            self._train(on_progress)
            return self.keeper.with_room(self._finish)
        finally:
            if not self._is_locked_by_caller:
                self._lock.release()

    def _train(self, on_progress: Callable[[Progress], None] | None) -> None:
        """Do all steps that are left, and write a checkpoint of the last one."""
        self.device.release_unused()  # after reading the data and the memory check
        try:
            with interruptions() as interrupted:
                while self.trainer.steps_done < self.config.steps:
                    for progress in self._advance(interrupted):
                        if on_progress is not None:
                            on_progress(progress)
                    if interrupted():
                        self.keeper.save()
                        raise KeyboardInterrupt
                if self.config.checkpoint_interval:
                    self.keeper.try_save()
                if interrupted():
                    raise KeyboardInterrupt
        finally:
            self.log.close()

    def _advance(self, stop: Callable[[], bool]) -> Iterator[Progress]:
        """Train up to the next step after which the state is looked at; fewer once ``stop()``."""
        trainer, done = self.trainer, self.trainer.steps_done
        if done == self.config.switch_step:
            self._log_psnr("before quantisation")
        config = self.config
        switch, intervals = config.switch_step, (config.log_interval, self.keeper.interval)
        moments = [switch, switch + 1, switch + 500, config.steps]
        moments += [(done // interval + 1) * interval for interval in intervals if interval]
        pause = min(moment for moment in moments if moment > done)
        for result in trainer.steps(pause - done, stop):
            yield self._look(result) if result.step == pause else Progress(result)

    def _look(self, result: StepResult) -> Progress:
        """Log and save what is due after a step; no later step is under way."""
        config = self.config
        progress = Progress(result)
        marks = {config.switch_step + 1: "just after", config.switch_step + 500: "500 steps after"}
        if result.step in marks and result.step > config.switch_step:
            progress.psnr = self._log_psnr(f"{marks[result.step]} the switch")
        if result.step % config.log_interval == 0 or result.step == config.steps:
            progress.psnr, state = self._psnr(), self.trainer.state
            progress.estimated_bytes = estimated_bytes(
                self.device, config, state.parameters, state.rate.scales
            )
            self.log.write(result, progress.psnr, progress.estimated_bytes)
        if self.keeper.interval and result.step % self.keeper.interval == 0:
            self.keeper.try_save()
        return progress

    def _log_psnr(self, moment: str) -> float | None:
        psnr = self._psnr()
        if psnr is not None:
            self.log.event(self.trainer.steps_done, f"psnr {moment}", psnr)
        return psnr

    def _psnr(self) -> float | None:
        """The PSNR of the fixed views; None if there are none."""
        views = self.fixed_views()
        return self.trainer.psnr(views) if views else None

    def fixed_views(self) -> list[View]:
        """The training views on which progress is measured, evenly spread."""
        views = self.dataset.train
        count = min(self.config.fixed_views, len(views))
        return [views[int(i)] for i in np.linspace(0, len(views) - 1, count).round()]

    def _finish(self) -> RunResult:
        """Write the scene and everything that is known of it."""
        config, dataset, device = self.config, self.dataset, self.device
        options = self.trainer.options
        self.log.flush()
        device.release_unused()
        scene = self._within_size(self.trainer.quantized_scene())
        save_scene(self.folder / "scene.npz", scene)
        views = dataset.test or dataset.train
        cameras = [view.camera for view in views[:HASHED_VIEWS]]
        hashes = fingerprint(device, scene, cameras, config.accuracy)
        write_json(self.folder / "hashes.json", hashes)
        bitstream = encode(scene)
        atomic_write(self.folder / "scene.clgs", bitstream)
        pictures = PictureFolder(self.folder, config.steps, [view.name for view in views])

        scores = evaluate_views(device, scene, views, pictures.add, options)
        summary = summarize(scene, scores, len(bitstream))
        if dataset.test:  # some training views, to compare with the held-out ones
            chosen = spread(dataset.train, TRAINING_VIEWS)
            renderer = Renderer(device, scene.dequantize(), options)
            mean = mean_psnr(renderer, chosen, scene.settings.background)
            summary |= {"train_psnr": mean, "train_views": len(chosen)}
        if config.target_size and not config.box:
            summary["target_size"] = config.target_size
        summary |= {
            "accuracy": config.accuracy,
            "split": "test" if dataset.test else "train",
            "steps": config.steps,
            "train_seconds": self.log.seconds,
            "seconds_per_step": self.log.seconds / max(1, config.steps),
            "peak_memory_bytes": peak_memory(),
            "device": ", ".join(self._names),
            "batch": config.batch,
            "skipped_images": dataset.skipped,
            "digest": run_digest(dataset, config),
            "merged_anchors": self.trainer.state.merged,
            "switch_psnr": self.log.events,
        }
        write_json(self.folder / "per_view.json", [score.record() for score in scores])
        write_json(self.folder / RESULTS, summary)
        return RunResult(self.folder, scene, bitstream, summary)

    def _within_size(self, scene: QuantizedScene) -> QuantizedScene:
        """The scene, or the part of it that fits the size asked for.

        Rounds of training meet the size. This is for runs of a few steps, which have none, and for
        networks that grew after the last round. What lies out of a box that learns stays.
        """
        target = 0 if self.config.box else self.config.target_size
        if not target or len(encode(scene)) <= target:
            return scene
        chosen = spread(self.dataset.train, MAX_VIEWS)
        judge = SceneJudge(self.device, chosen, self.fixed_views(), self.trainer.options)
        return reduce_to_size(scene, target, encode, judge).scene


def train_scene(
    dataset: Dataset,
    folder: str | Path,
    config: TrainConfig | None = None,
    *,
    device: Device | None = None,
    devices: Sequence[Device] = (),
    start: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> RunResult:
    """Train a scene; the run folder receives everything, ``scene.clgs`` included.

    Args:
        dataset: from :func:`clgs.load_dataset`; if it has no points, they are triangulated or
            drawn first, as ``clgs train`` does it.
        folder: run folder, made if it is missing.
        config: default ``TrainConfig()`` resolved for the dataset.
        device: default: chosen as ``clgs devices`` shows.
        devices: several in its place, of one kind; each looks at a view of every step, or at more
            if ``config.batch`` says so. One may be there twice: the result is the same.
        start: folder of a finished run to go on from, whose steps count.
        resume: continue from the folder's checkpoint if it has one; a run that is finished is
            read, and nothing is changed.
        overwrite: replace a run that the folder holds.
        on_progress: called after every step; the device may be a step ahead.

    Raises:
        DataError: nothing to train on, the folder holds another run, or ``start`` is of other data.
        ExistsError: it holds a run, which is neither to be resumed nor overwritten; a DataError.
        UsageError: ``folder`` is empty, ``resume`` and ``overwrite`` contradict each other, the
            devices are of different kinds, or more than there are training photos.
        BudgetError: the memory budget is too small for some view.
        NonFiniteLossError: the loss is not finite; names step and view.
        TypeError: ``dataset``, ``config``, ``devices`` or ``on_progress`` is of another class.
    """
    check_type("dataset", dataset, Dataset, "clgs.load_dataset(folder) reads one")
    check_type("config", config or TrainConfig(), TrainConfig, "clgs.preset(name) makes one")
    check_type("devices", devices, Sequence, "a list of clgs.Device()")
    if on_progress is not None and not callable(on_progress):
        raise TypeError(f"on_progress: is {type(on_progress).__name__}; give a function")
    for each in devices if device is None else (device, *devices):
        check_type("device", each, Device, "clgs.Device() opens one")
    if device is not None and devices:
        raise UsageError("device, devices: name one of both")
    check_together(devices)
    as_path("folder", folder)
    if not str(folder).strip():
        raise UsageError("folder: the name is empty; name the run folder")
    check_run_folder(Path(folder), resume, overwrite)
    resolved = (config or TrainConfig()).for_devices(len(devices)).for_dataset(dataset.kind)
    dataset = with_points(dataset, resolved, Path(folder))
    origin = None if start is None else Path(start)
    if origin is not None:
        posed = repose(dataset, finished_settings(origin)[0].scene.transform)
        if doubt := same_place(origin, dataset, posed, dataset.folder or Path("the data")):
            _log.warning("%s", doubt)
        dataset = posed
    finished = finished_run(Path(folder), dataset, resolved) if resume else None
    if finished is not None:
        return finished
    device, *others = devices or [device or Device()]
    first = None if origin is None else partial(state_of_run, device, dataset, folder=origin)
    session = Session(dataset, Path(folder), resolved, device, resume, first, others)
    return session.run(on_progress)
