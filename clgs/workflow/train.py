"""A data set to a trained scene with its report: `clgs train`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from clgs.data.origin import repose, same_place
from clgs.errors import DataError, UsageError
from clgs.exports.report import REPORT, write_run_report
from clgs.files import check_folder, write_json
from clgs.machine import return_freed_memory
from clgs.opencl.device import Device
from clgs.train.config import TrainConfig
from clgs.train.run.load import load_for, state_of_run, steps_done
from clgs.train.run.run_folder import (
    RunResult,
    check_run_folder,
    check_same_data,
    finished_run,
    finished_settings,
)
from clgs.train.run.session import Session
from clgs.train.step.batch import open_devices
from clgs.workflow.events import Note, OnEvent, TrainingProgress, ignore
from clgs.workflow.outputs import check_apart
from clgs.workflow.views import scene_name


@dataclass(frozen=True)
class TrainedRun:
    """A run: its result, its steps, and the times of its stages if they were asked for.

    was_finished: the folder held all of it already; times: (stage, calls, median milliseconds,
    seconds in all) of each stage.
    """

    result: RunResult
    steps: int
    was_finished: bool = False
    times: tuple[tuple[str, int, float, float], ...] = ()


def train(
    data: Path,
    folder: Path,
    config: TrainConfig,
    *,
    start: Path | None = None,
    device: str | None = None,
    devices: Sequence[str] = (),
    resume: bool = False,
    overwrite: bool = False,
    profile: bool = False,
    command: str = "",
    on_event: OnEvent = ignore,
) -> TrainedRun:
    """Train on the data set ``data``; the run folder receives everything, the report included.

    Args:
        data: folder of the data set.
        folder: run folder, made if it is missing.
        config: settings, not yet resolved for the data set.
        start: folder of a finished run to go on from, whose steps count.
        device: number or part of the name.
        devices: several in its place, each of which looks at a view of every step.
        resume: go on with the run in ``folder``; a finished one is read and not changed.
        overwrite: replace the run in ``folder``.
        profile: measure the time of every stage, which makes training slower.
        command: what repeats the run, for the report.
        on_event: receives progress and notes.

    Raises:
        DataError: the data set is missing or damaged, or not that of ``start``, or another process
            works in ``folder``.
        ExistsError: ``folder`` holds a run that is not this one.
        UsageError: ``folder`` cannot be a run folder, the devices cannot work together, or the box
            of what learns holds no anchor of ``start``.
        BudgetError: the memory budget is too small for some view.
    """
    return_freed_memory()
    check_folder(folder)
    if (folder / "checkpoint").is_file():
        raise UsageError(f"{folder / 'checkpoint'}: is not a folder; remove it")
    check_apart(folder, data)
    begun = None if start is None else _find_begun(start, folder, config)
    check_run_folder(folder, resume, overwrite)
    if resume:
        check_same_data(folder, data)
    opened, *others = open_devices(devices) if devices else [Device(device)]
    opened.profile.enabled = profile
    points = folder if start is None else start  # that run has triangulated some already
    dataset = load_for(config, data, points, lambda line: on_event(Note(line)))
    if begun is not None:
        posed = repose(dataset, begun.scene.transform)
        if doubt := same_place(begun.folder, dataset, posed, data):
            on_event(Note(doubt))
        dataset = posed
    config = config.for_devices(len(devices)).for_dataset(dataset.kind)
    further = "" if start is None else f", from {start} on"
    lead = f"Trained on {data}{further}."
    write_report = partial(write_run_report, folder, command, lead, title=scene_name(data))
    if resume and (finished := finished_run(folder, dataset, config)):
        return read_finished(finished, config.steps, write_report, on_event)
    first = None if start is None else partial(state_of_run, opened, dataset, folder=start)
    session = Session(dataset, folder, config, opened, resume, first, others)
    if start is not None and not session.trainer.heeds_lambda:
        text = f"{config.steps} steps come to no round that prices bytes; give more --steps"
        on_event(Note(f"lambda: {config.size_lambda:g} changes nothing, {text}"))
    result = session.run(lambda one: on_event(TrainingProgress(one, config.steps)))
    rows: list[tuple[str, int, float, float]] = []
    if profile:
        rows = opened.profile.rows()
        names = ("stage", "calls", "median_ms", "total_s")
        record = {"stages": [dict(zip(names, row, strict=True)) for row in rows]}
        write_json(folder / "profile.json", record)
    write_report()
    return TrainedRun(result, config.steps, times=tuple(rows))


def _find_begun(start: Path, folder: Path, config: TrainConfig) -> RunResult:
    """The run in ``start`` that is to go on in ``folder``; UsageError if it cannot."""
    if folder.resolve() == start.resolve():
        raise UsageError(f"{folder}: is the run to go on from; name another folder with -o")
    begun = finished_settings(start)[0]
    steps_done(begun, config)
    return begun


def read_finished(
    found: RunResult, steps: int, write_report: Callable[[], object], on_event: OnEvent
) -> TrainedRun:
    """A run of these steps that is finished; it may have been killed before it had its report."""
    if (found.folder / REPORT).exists():
        return TrainedRun(found, steps, was_finished=True)
    try:
        write_report()
    except DataError as error:  # its pictures are not needed otherwise, and may be removed
        on_event(Note(f"no {REPORT}: {error}"))
        return TrainedRun(found, steps, was_finished=True)
    return TrainedRun(found, steps)
