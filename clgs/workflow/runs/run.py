"""Photos to a scene, a report and what one shows to others: `clgs run`."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from numbers import Real
from pathlib import Path
from typing import Any

from clgs.arguments import as_path, check_range, check_type
from clgs.errors import UsageError
from clgs.exports.camera_path import read_camera_path
from clgs.files import check_folder, make_folder
from clgs.train.config import TrainConfig, layered, options_of
from clgs.train.run.run_folder import FolderLock
from clgs.workflow.events import Note, OnEvent, StageRecord, ignore
from clgs.workflow.options import PATHS
from clgs.workflow.pictures import check_path_name
from clgs.workflow.runs.clocks import PosesClock
from clgs.workflow.runs.plan import (
    DEFAULT_SECONDS,
    LATE,
    LEAST_SHARE,
    Photos,
    Presentation,
    StepSpeed,
    TrainingPlan,
    frames_within,
    make_plan,
    must_hurry,
    poses_time,
)
from clgs.workflow.runs.record import (
    DATA,
    FinishedRun,
    RunInput,
    RunPlan,
    RunRecord,
    find_input,
    in_words,
    measure_data,
    read_record,
)
from clgs.workflow.runs.stages import MADE, RunStages
from clgs.workflow.views import scene_name

CORES = os.cpu_count() or 1

PLANNED = {
    "steps": "the plan decides it; give --steps",
    "max_size": "the plan decides it; give --max-size",
    "seed": "all stages share it; give --seed",
    "preset": "the plan is that of preset quick; give its settings one by one",
    "downscale": "the plan reduces photos to a width; give max_size",
    "coarse_to_fine": "the plan decides it",
}
"""Settings of training that the plan of a run decides, and what to give instead."""


def plan_run(
    photos: Path | str,
    output: Path | str,
    *,
    seconds: float | None = None,
    steps: int | None = None,
    max_size: int | None = None,
    seed: int | None = None,
    settings: Mapping[str, Any] | None = None,
    shown: Presentation | None = None,
    device: str | None = None,
    on_event: OnEvent = ignore,
) -> RunPlan:
    """What :func:`run` would do with these arguments; nothing is written.

    Raises:
        ExistsError: ``output`` holds other files than a run's.
        DataError: there is nothing that can be trained on.
        DeviceError: there is no such device.
    """
    photos, output = as_path("photos", photos), as_path("output", output)
    _check_numbers(seconds, steps, max_size, seed)
    _check_settings(settings or {})
    _check_shown(shown or Presentation())
    check_folder(output)
    read_record(output, resume=False, overwrite=True)
    given, allowed = _find_input(photos, settings or {}), seconds or DEFAULT_SECONDS
    stages = RunStages(output, _record(given, allowed), seed or 0, device, on_event)
    return _Planner(stages, on_event, allowed, steps, max_size, shown).plan(
        _shortened(given, allowed)
    )


def run(
    photos: Path | str,
    output: Path | str,
    *,
    seconds: float | None = None,
    steps: int | None = None,
    max_size: int | None = None,
    seed: int | None = None,
    settings: Mapping[str, Any] | None = None,
    shown: Presentation | None = None,
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
        settings: of training, by the names of :class:`clgs.TrainConfig`, such as ``size_lambda``,
            ``target_size`` or ``exposure``.
        shown: title, and path, length and size of the clip; default: what photos and time allow.
        device: number or part of the name.
        resume: go on with the run in ``output`` by its plan; begin if there is none. With other
            ``seconds`` than before, only the poses are kept, and these are for all that follows.
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
    photos, output = as_path("photos", photos), as_path("output", output)
    _check_numbers(seconds, steps, max_size, seed)
    _check_settings(settings or {})
    _check_shown(shown or Presentation())
    check_folder(output)
    lock = FolderLock(output) if output.is_dir() else None
    try:
        found = read_record(output, resume, overwrite)
        if resume and found is None:
            on_event(Note(f"{output} holds no run yet; one begins"))
        given = _find_input(photos, settings or {})
        if found is not None:
            chosen = {"steps": steps, "max_size": max_size, "seed": seed, **(settings or {})}
            found.check(output, given, seconds, chosen)
            there = given.posed or (output / DATA).is_dir()
            found = _planned_for(found, seconds, there, on_event)
        allowed = seconds or (found.time if found else DEFAULT_SECONDS)
        record = found or _record(given, allowed)
        given, shown = _shortened(given, allowed), shown or Presentation()
        title = shown.title or record.plan.get("title") or scene_name(given.path)
        shown = replace(shown, title=title)
        stages = RunStages(output, record, seed or 0, device, on_event, begun=found is not None)
        planner = _Planner(stages, on_event, allowed, steps, max_size, shown)
        training, hurry = None, record.plan.get("hurry")
        if not record.settings:
            plan = planner.plan(given, hurry)
            given, training, hurry = plan.input, plan.training, plan.hurry
            record.plan["hurry"] = hurry
            on_event(StageRecord(plan))
        if found is None:
            _check_apart(given.path, output)
            make_folder(output)
            lock = lock or FolderLock(output)
        if not record.settings:
            stages.begin(kept=() if found is None else (DATA,))
        data = given.path
        if not given.posed:
            follow = on_event if training is None else planner.follow(given.photos, bool(hurry))
            data = stages.prepare(given, bool(hurry), max_size, follow)
        if training is not None:
            posed = _measured(given, data, settings or {}, on_event)
            if not given.complete:
                training = planner.plan_training(posed, 0.0, data)
                on_event(StageRecord(training))
            stages.settle(training, {**posed.mask_settings(), **(settings or {})}, shown.title)
        stages.train(data)
        stages.encode()
        stages.evaluate(data)
        failures = stages.export(shown)
        return stages.finish(given, data, failures, shown)
    finally:
        if lock is not None:
            lock.release()


def _find_input(path: Path, settings: Mapping[str, Any]) -> RunInput:
    given = find_input(path)
    pointless = given.pointless and not settings.get("points")
    return replace(given, photos=_with_meaning(given.photos, settings), pointless=pointless)


def _measured(
    given: RunInput, data: Path, settings: Mapping[str, Any], on_event: OnEvent
) -> Photos:
    """The photos of the data set ``data``; a note says what its masks mean if that is news."""
    if given.posed:
        return given.photos
    photos = _with_meaning(measure_data(data), settings)
    if (words := photos.masks_in_words()) != given.photos.masks_in_words():
        on_event(Note(words or "no photo is masked"))
    return photos


def _with_meaning(photos: Photos, settings: Mapping[str, Any]) -> Photos:
    """The photos whose masks mean what ``settings`` say, if they say it."""
    return replace(photos, meaning=settings.get("masks", photos.meaning))


def _check_numbers(seconds: float | None, *whole: int | None) -> None:
    """Raise TypeError for what is no number, UsageError for one that cannot be used."""
    check_type("seconds", seconds or 0.0, Real, "such as 300")
    if seconds is not None and not 0 < seconds < inf:
        raise UsageError(f"seconds: {seconds} is not a finite number above 0")
    for name, value, least in zip(("steps", "max_size", "seed"), whole, (1, 1, 0), strict=True):
        if value is not None:
            check_range(name, value, least)
            options_of(TrainConfig)[name].check(value)


def _check_shown(shown: Presentation) -> None:
    """Raise UsageError, or DataError for a file, if no clip can be made as ``shown`` asks."""
    check_type("shown", shown, Presentation, "see clgs.workflow.runs.plan")
    if shown.path == "none" and (shown.seconds or shown.size):
        raise UsageError("--clip none: there is no clip of a time or a size; leave these out")
    if shown.path not in (None, "none"):
        check_path_name("--clip", shown.path)
        if shown.path not in PATHS:
            read_camera_path(Path(shown.path))
    if shown.size is not None and (shown.size[0] % 2 or shown.size[1] % 2):
        raise UsageError("--clip-size {}x{}: a video needs even numbers".format(*shown.size))


def _check_settings(settings: Mapping[str, Any]) -> None:
    """Raise UsageError if ``settings`` are none, do not go together, or are those of the plan."""
    check_type("settings", settings, Mapping, "such as {'exposure': True}")
    for name in PLANNED.keys() & settings.keys():
        raise UsageError(f"{name}: {PLANNED[name]}")
    layered({"preset": "quick", **settings})
    if settings.get("target_size") and settings.get("size_lambda") is not None:
        raise UsageError("size_lambda: follows from target_size; give one of the two")


def _planned_for(
    found: RunRecord, seconds: float | None, posed: bool, on_event: OnEvent
) -> RunRecord:
    """The record of a run; without its settings if the run is to take other ``seconds``.

    ``posed``: its poses are there, so that it is decided whether they are tested.
    """
    if seconds in (None, found.time):
        return found
    kept = "the poses are kept; training" if posed else "the run"
    on_event(Note(f"{kept} is planned again{' and starts over' * posed}"))
    plan = {name: value for name, value in found.plan.items() if posed or name != "hurry"}
    return replace(found, time=seconds, settings={}, made={}, plan=plan)


def _record(given: RunInput, allowed: float) -> RunRecord:
    return RunRecord(str(given.path.resolve()), given.photos.count, given.digest, allowed)


def _shortened(given: RunInput, allowed: float) -> RunInput:
    """The input with as many frames as the time allows, if it is a video."""
    if not given.video:
        return given
    photos = replace(given.photos, count=frames_within(given.photos, CORES, allowed))
    return replace(given, photos=photos)


def _check_apart(photos: Path, output: Path) -> None:
    """Raise UsageError if ``photos`` lie where files of an earlier run are removed."""
    inside = {photos.resolve(), *photos.resolve().parents}
    if any((output / name).resolve() in inside for name in MADE):
        raise UsageError(f"{photos}: lies in the folder that is written to; copy it first")


@dataclass
class _Planner:
    """Chooses size and length of training by the speed of the device and the time that is left."""

    stages: RunStages
    on_event: OnEvent
    allowed: float
    steps: int | None
    max_size: int | None
    shown: Presentation | None
    start: float = field(default_factory=time.perf_counter)
    speed: StepSpeed | None = None
    """That of the last measurement."""

    def plan(self, given: RunInput, hurry: bool | None = None) -> RunPlan:
        """The plan before anything is done. ``hurry``: whether poses are tested if it is known."""
        with self.stages.timed("plan"):
            given = replace(given, photos=self.stages.try_photos(given))
        if hurry is None:
            hurry = must_hurry(given.photos, CORES, self.allowed)
        if given.complete:
            training = self.plan_training(given.photos, 0.0, given.path)
        else:
            preparing = poses_time(given.photos, CORES, hurry or given.pointless).seconds
            preparing *= not self.stages.posed
            training = self.plan_training(given.photos, preparing, None)
        return RunPlan(given, training, self.stages.device.name, hurry, self.allowed)

    def plan_training(self, photos: Photos, preparing: float, data: Path | None) -> TrainingPlan:
        """The plan by the speed on the data set ``data``, if there is one already."""
        with self.stages.timed("plan"):
            self.speed = speed = self.stages.measure_speed(photos, data)
        used = time.perf_counter() - self.start
        left = max(self.allowed - used, LEAST_SHARE * self.allowed + preparing)
        plan = make_plan(photos, speed, preparing, left, self.steps, self.max_size, self.shown)
        whole = used + plan.seconds
        if data is not None and whole > LATE * self.allowed:
            spent = f"{in_words(used)} of {in_words(self.allowed)} are spent"
            kept = f"{LEAST_SHARE:.0%} of the time are kept for training and what follows"
            self.on_event(Note(f"{spent}; {kept}, so that all takes about {in_words(whole)}"))
        return plan

    def follow(self, photos: Photos, hurry: bool) -> PosesClock:
        """Receive events of the stage that finds poses; training is planned again if it is off."""
        began = time.perf_counter()

        def plan_again(said: float, taken: float) -> None:
            used = time.perf_counter() - self.start
            left = taken - (time.perf_counter() - began)
            self.on_event(
                Note(
                    f"by the first photos, poses take about {in_words(taken)} instead of "
                    f"{in_words(said)}; this is the plan now"
                )
            )
            assert self.speed is not None
            within = max(self.allowed - used, LEAST_SHARE * self.allowed + left)
            plan = make_plan(
                photos, self.speed, left, within, self.steps, self.max_size, self.shown
            )
            self.on_event(StageRecord(plan))

        return PosesClock(poses_time(photos, CORES, hurry), plan_again, self.on_event)
