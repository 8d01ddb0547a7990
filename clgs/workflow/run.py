"""From photos to a scene, a report and what one shows to others: `clgs run`."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from clgs.codec.scene_encoder import encode
from clgs.errors import UsageError
from clgs.export.run_report import RunStory, write_run_report
from clgs.files import atomic_write, check_folder, make_folder, remove_temporaries, write_json
from clgs.opencl.device import Device
from clgs.train.config import layered
from clgs.train.run.finished_run import RESULTS
from clgs.train.run.folder_lock import FolderLock
from clgs.workflow.device_speed import speed_on, synthetic_speed
from clgs.workflow.encode import EncodedFile
from clgs.workflow.evaluate import Evaluation, evaluate
from clgs.workflow.events import Note, OnEvent, RunStage, StageFailure, StageRecord, ignore
from clgs.workflow.export import export
from clgs.workflow.options import PathOptions, ViewOptions
from clgs.workflow.pictures import render_clip
from clgs.workflow.prepare import prepare_data
from clgs.workflow.run_input import RunInput, find_input, measure_data
from clgs.workflow.run_plan import (
    DEFAULT_SECONDS,
    Photos,
    TrainingPlan,
    frames_within,
    make_plan,
    must_hurry,
    prepare_seconds,
)
from clgs.workflow.run_record import DATA, RUN, RunRecord, read_record
from clgs.workflow.scenes import read_drawable, read_scene
from clgs.workflow.train import train

SCENE, SCORES, REPORT = "scene.clgs", "scores.json", "report.html"
PAGE, GAUSSIANS, CLIP = "scene.html", "scene.ply", "clip.mp4"
MADE = (DATA, RUN, SCENE, SCORES, REPORT, PAGE, GAUSSIANS, CLIP)
CLIP_FRAMES = 120

NEEDED = (SCENE, "scene.npz", "hashes.json", "per_view.json", "progress.csv")
"""Files of the run folder that later stages need."""


@dataclass(frozen=True)
class RunPlan:
    """What `clgs run` is going to do.

    Attributes:
        input: photos, video or data set.
        training: size, length and times.
        device: the name of the device.
        hurry: whether the poses are not tested, for lack of time.
        allowed: seconds for everything.
    """

    input: RunInput
    training: TrainingPlan
    device: str
    hurry: bool
    allowed: float


@dataclass(frozen=True)
class FinishedRun:
    """What `clgs run` made.

    Attributes:
        folder: the output folder.
        photos: how many photos were used, in words.
        scores: as ``clgs eval --json`` writes them.
        seconds: by stage, over all calls that worked on the run.
        failures: the exports that failed, by stage.
    """

    folder: Path
    photos: str
    scores: dict[str, Any]
    seconds: dict[str, float]
    failures: dict[str, Exception]


def plan_run(
    photos: Path | str,
    output: Path | str,
    *,
    seconds: float | None = None,
    steps: int | None = None,
    max_size: int | None = None,
    seed: int | None = None,
    device: str | None = None,
    on_event: OnEvent = ignore,
) -> RunPlan:
    """What :func:`run` would do with these arguments; nothing is written.

    Raises:
        ExistsError: ``output`` holds other files than a run's.
        DataError: there is nothing that can be trained on.
        DeviceError: there is no such device.
    """
    output = Path(output)
    check_folder(output)
    read_record(output, resume=False, overwrite=True)
    given, allowed = find_input(Path(photos)), seconds or DEFAULT_SECONDS
    begun = _Run(output, _record(given, allowed), steps, max_size, seed or 0, device, on_event)
    return begun.plan(_shortened(given, allowed))


def run(
    photos: Path | str,
    output: Path | str,
    *,
    seconds: float | None = None,
    steps: int | None = None,
    max_size: int | None = None,
    seed: int | None = None,
    device: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    on_event: OnEvent = ignore,
) -> FinishedRun:
    """Find poses, train, encode, score the file, and write page, Gaussians, clip and report.

    Resolution and steps are chosen so that all of it fits ``seconds`` on the device.

    Args:
        photos: folder of photos, a video, or folder of a data set.
        output: folder for all files.
        seconds: for everything; default: DEFAULT_SECONDS.
        steps: of training; default: what the time allows.
        max_size: wider photos are reduced to this width; default: what the time allows.
        seed: of all random choices; default: 0.
        device: number or part of the name.
        resume: go on with the run in ``output`` by its plan; begin if there is none.
        overwrite: replace the run in ``output``.
        on_event: receives plan, stages, their records, progress and notes.

    Returns:
        What was made. An export that fails does not end the run; ``failures`` has its error.

    Raises:
        DataError: there is nothing to train on, or another process works in ``output``.
        ExistsError: ``output`` holds other files, or a run that is neither resumed nor replaced.
        UsageError: a resumed run has another input or other settings.
        ClgsError: a stage failed.
    """
    output = Path(output)
    check_folder(output)
    lock = FolderLock(output) if output.is_dir() else None
    try:
        found = read_record(output, resume, overwrite)
        if resume and found is None:
            on_event(Note(f"{output} holds no run yet; one begins"))
        given = find_input(Path(photos))
        if found is not None:
            chosen = {"steps": steps, "max_size": max_size, "seed": seed}
            found.check(output, given, seconds, chosen)
        allowed = seconds or (found.time if found else DEFAULT_SECONDS)
        record = found or _record(given, allowed)
        given = _shortened(given, allowed)
        this = _Run(output, record, steps, max_size, seed or 0, device, on_event)
        this.begun = found is not None
        plan = None
        if not record.settings:
            plan = this.plan(given)
            on_event(StageRecord(plan))
        if found is None:
            _check_apart(given.path, output)
            make_folder(output)
            lock = lock or FolderLock(output)
            this.begin()
        return this.work(given, plan)
    finally:
        if lock is not None:
            lock.release()


def _record(given: RunInput, allowed: float) -> RunRecord:
    return RunRecord(str(given.path.resolve()), given.photos.count, given.digest, allowed)


def _shortened(given: RunInput, allowed: float) -> RunInput:
    """The input with as many frames as the time allows, if it is a video."""
    if not given.video:
        return given
    count = frames_within(os.cpu_count() or 1, allowed)
    return replace(given, photos=replace(given.photos, count=count))


def _check_apart(photos: Path, output: Path) -> None:
    """Raise UsageError if ``photos`` lie where files of an earlier run are removed."""
    inside = {photos.resolve(), *photos.resolve().parents}
    if any((output / name).resolve() in inside for name in MADE):
        raise UsageError(f"{photos}: lies in the folder that is written to; copy it first")


class _Run:
    """One call: the record of the run, the choices of the user, and the device."""

    def __init__(
        self,
        out: Path,
        record: RunRecord,
        steps: int | None,
        max_size: int | None,
        seed: int,
        device: str | None,
        on_event: OnEvent,
    ) -> None:
        self._out, self._record, self._on_event = out, record, on_event
        self._steps, self._max_size, self._seed = steps, max_size, seed
        self._device_name = device
        self._start = time.perf_counter()
        self.begun = False
        """Whether the record is written; before, the folder may hold another run."""

    @cached_property
    def _device(self) -> Device:
        return Device(self._device_name)

    def plan(self, given: RunInput) -> RunPlan:
        """Size and length of training, by the speed of the device."""
        count, cores, allowed = given.photos.count, os.cpu_count() or 1, self._record.time
        hurry = must_hurry(count, cores, allowed)
        preparing = 0.0
        if not given.complete:
            preparing = prepare_seconds(count, cores, hurry or given.pointless)
        ready = given.path if given.complete else None
        training = self._plan_training(given.photos, preparing, ready)
        return RunPlan(given, training, self._device.name, hurry, allowed)

    def _plan_training(self, photos: Photos, preparing: float, data: Path | None) -> TrainingPlan:
        """The plan by the speed on ``data``, if that is there already."""
        with self._timed("plan"):
            self._on_event(Note("measuring how fast this device trains"))
            if data is None:
                speed = synthetic_speed(self._device)
            else:
                run = self._out / RUN
                speed = speed_on(self._device, data, photos, run, self._seed, self._on_event)
        left = self._record.time - (time.perf_counter() - self._start)
        return make_plan(photos, speed, preparing, left, self._steps, self._max_size)

    def begin(self) -> None:
        """Write the record, and remove what an earlier run left."""
        self.begun = True
        self._record.write(self._out)
        for path in (self._out / name for name in MADE):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)

    def work(self, given: RunInput, plan: RunPlan | None) -> FinishedRun:
        """All stages that are left; ``plan`` is None if the record has the settings."""
        out, run = self._out, self._out / RUN
        data = given.path if given.posed else self._prepare(given)
        if plan is not None:
            training = plan.training
            if not given.complete:
                training = self._plan_training(measure_data(data), 0.0, data)
                self._on_event(StageRecord(training))
            settings = {"steps": training.steps, "max_size": training.max_size}
            settings |= {"seed": self._seed, "coarse_to_fine": training.coarse}
            self._record = replace(self._record, settings=settings, plan=asdict(training))
            self._record.write(out)
        settings = self._record.settings
        self._train(data, run, settings)
        self._encode(run)
        self._evaluate(data, run, settings)
        failures = self._export(run)
        if given.posed:
            used = f"{given.photos.count} of the data set {given.path}"
        else:
            used = f"{measure_data(data).count} of {given.photos.count} found their pose"
        links = {"the scene as a web page": PAGE, "clip": CLIP, "the file": SCENE}
        links |= {"ordinary Gaussians": GAUSSIANS, "poses of the photos": f"{DATA}/{REPORT}"}
        present = [(label, name) for label, name in links.items() if (out / name).exists()]
        words = ["run", given.path, "-o", out, *_options(settings)]
        if self._device_name is not None:
            words += ["--device", self._device_name]
        seconds = self._record.seconds
        story = RunStory(_command(*words), f"{used}.", seconds, present)
        write_run_report(run, story, out / REPORT)
        scores = json.loads((out / SCORES).read_text(encoding="utf-8"))
        return FinishedRun(out, used, scores, seconds, failures)

    def _prepare(self, given: RunInput) -> Path:
        """Find the poses; the folder of the data set."""
        data = self._out / DATA
        quick = must_hurry(given.photos.count, os.cpu_count() or 1, self._record.time)
        frames = given.photos.count if given.video else None
        words = ["prepare", given.path, "-o", data, "--seed", self._seed]
        words += ["--quick"] * quick + ["--frames", frames] * given.video

        def work() -> object:
            return prepare_data(
                given.path,
                data,
                seed=self._seed,
                quick=quick,
                frames=frames,
                on_event=self._on_event,
            )

        self._stage("prepare", data, words, work)
        return data

    def _train(self, data: Path, run: Path, settings: dict[str, Any]) -> None:
        """Train; what a damaged run lacks is made again from its last checkpoint."""
        if not all((run / name).is_file() for name in NEEDED):
            (run / RESULTS).unlink(missing_ok=True)
        device = self._device.name
        words = ["train", data, "-o", run, "--preset", "quick", *_options(settings, "=")]
        words += ["--coarse-to-fine"] * bool(settings.get("coarse_to_fine")) + ["--device", device]
        given = {name: value for name, value in settings.items() if value is not False}
        config = layered({}, {"preset": "quick", **given})

        def work() -> object:
            return train(
                data,
                run,
                config,
                device=device,
                resume=True,
                command=_command(*words),
                on_event=self._on_event,
            )

        self._stage("train", run / RESULTS, [*words, "--resume"], work)

    def _encode(self, run: Path) -> None:
        file = self._out / SCENE

        def work() -> EncodedFile:
            scene, _ = read_scene(run)
            data = encode(scene)
            atomic_write(file, data)
            return EncodedFile(file, len(data), len(scene.anchors))

        self._stage("encode", file, ["encode", run, "-o", file, "--overwrite"], work)

    def _evaluate(self, data: Path, run: Path, settings: dict[str, Any]) -> None:
        """Score the file on the views that the run was scored on."""
        file, scores, device = self._out / SCENE, self._out / SCORES, self._device.name
        split = json.loads((run / RESULTS).read_text(encoding="utf-8"))["split"]
        size = settings["max_size"]
        words = ["eval", file, "--data", data, "--json", scores]
        words += ["--max-size", size, "--split", split, "--device", device]

        def work() -> Evaluation:
            views = ViewOptions(data, split, max_size=size, device=device)
            scene, nbytes = read_drawable(file)
            opened = Device(device)
            found = evaluate(opened, file, scene, nbytes, views, on_event=self._on_event)
            write_json(scores, found.record())
            return found

        self._stage("eval", scores, words, work)

    def _export(self, run: Path) -> dict[str, Exception]:
        """Write page, Gaussians and clip; the errors of those that failed."""
        page, gaussians, clip = (self._out / name for name in (PAGE, GAUSSIANS, CLIP))
        for path in (page, gaussians, clip):
            remove_temporaries(path)
        device, on_event = self._device.name, self._on_event
        shared = ["--device", device, "--overwrite"]
        path_words = ["--path", "interpolate", "--frames", CLIP_FRAMES]

        def write_clip() -> object:
            path, views = PathOptions("interpolate", CLIP_FRAMES), ViewOptions(device=device)
            return render_clip(run, clip, path, views, overwrite=True, on_event=on_event)

        def write(file: Path) -> Callable[[], object]:
            return lambda: export(run, file, device=device, overwrite=True, on_event=on_event)

        todo: list[tuple[str, Path, list[Any], Callable[[], object]]] = [
            ("page", page, ["export", run], write(page)),
            ("Gaussians", gaussians, ["export", run], write(gaussians)),
            ("clip", clip, ["render", run, *path_words], write_clip),
        ]
        failures: dict[str, Exception] = {}
        for name, file, words, work in todo:
            if name == "clip" and find_spec("imageio_ffmpeg") is None:
                needs = "left out; it needs: pip install 'clgs[video]'"
                on_event(RunStage(name, needs, skipped=True))
                continue
            try:
                self._stage(name, file, [*words, "-o", file, *shared], work, needed=False)
            except Exception as error:
                failures[name] = error
                on_event(StageFailure(name, error))
        return failures

    def _stage(
        self,
        name: str,
        made: Path,
        words: list[Any],
        work: Callable[[], object],
        needed: bool = True,
    ) -> None:
        """Do the work of a stage, unless ``made`` is there as it was made.

        ``words`` are the arguments of the command that does the same.
        """
        size = self._record.made.get(made.name)
        if made.is_dir() or (made.is_file() and made.stat().st_size == size):
            self._on_event(RunStage(name, f"is there: {made}", skipped=True))
            return
        self._on_event(RunStage(name, _command(*words)))
        try:
            with self._timed(name):
                record = work()
                if made.is_file():
                    self._record.made[made.name] = made.stat().st_size
        except Exception as error:
            if needed:
                error.add_note(f"{name} failed; mend that and repeat the command with --resume")
            raise
        self._on_event(StageRecord(record))

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        """Add the seconds of the block to those of ``stage``, and write the record."""
        start, seconds = time.perf_counter(), self._record.seconds
        try:
            yield
        finally:
            seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start
            if self.begun:
                self._record.write(self._out)


def _command(*words: object) -> str:
    return shlex.join(["clgs", *map(str, words)])


def _options(settings: dict[str, Any], between: str | None = None) -> list[str]:
    """The settings that the user may choose too, as options with their values."""
    found: list[str] = []
    for name, value in settings.items():
        if not isinstance(value, bool):
            option = f"--{name.replace('_', '-')}"
            found += [option, str(value)] if between is None else [f"{option}{between}{value}"]
    return found
