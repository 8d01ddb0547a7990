"""A whole run in blocks: a coarse scene, blocks side by side, the merged scene.

Each block gives the merged scene the anchors that it owns.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from clgs.cluster.block_plan import (
    GROWTH,
    Cuts,
    Plan,
    counts_for_memory,
    look,
    make_plan,
    parse_counts,
    read_plan,
    up_of,
)
from clgs.cluster.block_task import (
    block_state,
    block_tasks,
    check_settings,
    coarse_config,
    joint_begin,
    joint_config,
    train_block,
)
from clgs.cluster.engine import (
    Message,
    common_kind,
    connected,
    memory_per_worker,
    require_distributed,
    run_tasks,
)
from clgs.cluster.worker import Task, Tell, forget_peak_memory, opened_device
from clgs.codec.scene_encoder import sort_anchors
from clgs.constants import LEAST_CONTRIBUTION
from clgs.data.dataset import load_dataset
from clgs.data.origin import repose
from clgs.errors import ClgsError, DataError, UsageError
from clgs.exports.report import write_run_report
from clgs.files import check_folder, make_folder, write_json
from clgs.machine import available_memory, peak_memory, return_freed_memory
from clgs.opencl.device import Device
from clgs.scene.anchors import concatenate, take
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import load_scene
from clgs.train.config import TrainConfig
from clgs.train.run.load import load_for
from clgs.train.run.run_folder import (
    BLOCKS,
    COARSE,
    RESULTS,
    FolderLock,
    RunResult,
    check_run_folder,
    check_same_data,
    finished_run,
    remove_run,
)
from clgs.train.run.session import Session
from clgs.workflow.events import Note, OnEvent, StageProgress, TrainingProgress, counter, ignore
from clgs.workflow.outputs import check_apart
from clgs.workflow.train import TrainedRun, read_finished
from clgs.workflow.views import scene_name


def merged_scene(folder: Path, cuts: Cuts, coarse: QuantizedScene) -> QuantizedScene:
    """The scene of the blocks in ``folder``, in Morton order, with the MLPs of the coarse one.

    Raises:
        DataError: the scene of a block is missing or damaged, or not of these units.
    """
    parts, scales = [], coarse.scales
    for number, name in enumerate(cuts.names):
        path = folder / name / "scene.npz"
        block = load_scene(path)
        if (block.scales, block.transform) != (scales, coarse.transform):
            raise DataError(f"{path}: has other units than the coarse scene; remove its folder")
        owned = cuts.owner(block.anchors.position) == number
        parts.append(take(block.anchors, np.flatnonzero(owned)))
    return replace(coarse, anchors=sort_anchors(concatenate(parts)))


ROWS = "rows.json"
"""What is known of each block: its time, its anchors, the peak of its worker's memory."""


class BlockError(ClgsError):
    """A block failed, with the exit code of its own error."""

    def __init__(self, problem: str, exit_code: int) -> None:
        super().__init__(problem)
        self.exit_code = exit_code


def train_in_blocks(
    data: Path,
    folder: Path,
    config: TrainConfig,
    blocks: str,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    device: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    command: str = "",
    on_event: OnEvent = ignore,
) -> TrainedRun:
    """Train on ``data`` in blocks; ``folder`` receives what an ordinary run has, and more.

    That is a coarse scene of all photos at half their size, blocks that start from it, with MLPs
    that rest, and the scene of all that blocks own, which is priced and learns as a whole. The
    result depends on the blocks and not on who trained them.

    Args:
        data: folder of the data set; workers see it, and ``folder``, under the same names.
        folder: run folder, made if it is missing.
        config: settings, not yet resolved for the data set.
        blocks: NxM, or "auto": as few as the memory of a worker allows.
        workers: processes on this machine; None: blocks are trained in this one.
        scheduler: address of a scheduler of dask, in place of them.
        device: number or part of the name, as workers see it, too.
        resume: go on with the run in ``folder``.
        overwrite: replace it.
        command: what repeats the run, for the report.
        on_event: receives progress and notes.

    Raises:
        UsageError: blocks or settings that cannot be, no scheduler, or a worker that is refused.
        DataError, ExistsError, BudgetError: as :func:`clgs.workflow.train.train`.
        ClgsError: a block failed; names it.
    """
    counts = parse_counts(blocks)
    check_settings(config)
    check_apart(folder, data)
    check_folder(folder)
    check_run_folder(folder, resume, overwrite, in_blocks=True)
    if resume:
        check_same_data(folder / COARSE, data)
        begun = read_plan(folder / BLOCKS)
        if begun is not None and counts not in (None, begun.cuts.counts):
            there = "x".join(map(str, begun.cuts.counts))
            raise UsageError(f"--blocks: {folder} was begun with {there}; give that, or auto")
    memory = _memory_of_a_worker(folder, workers, scheduler, device)
    return_freed_memory()
    config, width = _resolved(data, config, counts)
    opened = opened_device(device)
    make_folder(folder)
    lock = FolderLock(folder)
    try:
        if overwrite:
            remove_run(folder)
        joint = joint_config(config)
        write_report = partial(_write_report, data, folder, command)
        if (folder / RESULTS).exists():
            whole = load_for(joint, data, folder)
            if found := finished_run(folder, whole, joint):
                return read_finished(found, config.steps, write_report, on_event)
        reduced = coarse_config(config, width)
        coarse, plan = _coarse_and_plan(data, folder, reduced, counts, opened, memory, on_event)
        rows, columns = plan.cuts.counts
        shares = ", ".join(f"{name}: {len(names)}" for name, names in plan.train.items())
        on_event(Note(f"{rows} x {columns} blocks; training photos of each: {shares}"))
        tasks = block_tasks(data, folder, config, plan, len(coarse.scene.anchors))
        on_message = _follow(tasks, on_event)
        if workers is None and scheduler is None:
            trained = [train_block({**task, "device": device}, on_message) for task in tasks]
        else:
            with connected(workers or 1, scheduler) as client:
                kernels = folder / BLOCKS / "kernels"
                trained = run_tasks(
                    client, train_block, tasks, kernels, lambda row: None, on_message, device
                )
        if failed := [row for row in trained if "error" in row]:
            row = failed[0]
            raise BlockError(f"block {row['run']}: {row['error']}", row["exit_code"])
        write_json(folder / BLOCKS / ROWS, sorted(trained, key=lambda row: str(row["run"])))
        merged = merged_scene(folder / BLOCKS, plan.cuts, coarse.scene)
        result = _train_merged(data, folder, joint, merged, opened, lock, on_event)
        write_report()
        return TrainedRun(result, config.steps)
    finally:
        lock.release()


def _train_merged(
    data: Path,
    folder: Path,
    config: TrainConfig,
    merged: QuantizedScene,
    device: Device,
    lock: FolderLock,
    on_event: OnEvent,
) -> RunResult:
    """The run of all that blocks own, with the settings ``config`` of its part of the steps."""
    forget_peak_memory()
    on_event(Note(f"{len(merged.anchors):,} anchors merged; all learn for the steps that are left"))
    whole = load_for(config, data, folder, lambda line: on_event(Note(line)))
    whole = repose(whole, merged.transform)
    first = partial(block_state, device, whole, merged, joint_begin(config))
    session = Session(whole, folder, config, device, resume=True, first=first, lock=lock)
    return session.run(lambda one: on_event(TrainingProgress(one, config.steps)))


def _write_report(data: Path, folder: Path, command: str) -> None:
    """Write the report on the finished run in ``folder``."""
    plan = read_plan(folder / BLOCKS)
    count = "" if plan is None else f"{len(plan.train)} "
    lead = f"Trained on {data} in {count}blocks."
    write_run_report(folder, command, lead=lead, title=scene_name(data))


def _memory_of_a_worker(
    folder: Path, workers: int | None, scheduler: str | None, device: str | None
) -> int | None:
    """Bytes that each worker can have; None: unknown. Makes sure that those there can be used."""
    if scheduler is not None:
        with connected(1, scheduler) as client:
            common_kind(client, folder / BLOCKS / "kernels", device)
            return memory_per_worker(client)
    if workers is not None:
        require_distributed()
    free = available_memory()
    return None if free is None else free // (workers or 1)


def _resolved(
    data: Path, config: TrainConfig, counts: tuple[int, int] | None
) -> tuple[TrainConfig, int]:
    """The settings for the data set, and the width of its widest photo in pixels; none is read.

    ``counts``: of rows and columns of blocks, None if they are not known yet.
    """
    outline = load_dataset(
        *(data,),
        downscale=config.downscale,
        max_size=config.max_size,
        load_images=False,
        test_every=config.test_every,
        fisheye_view=config.fisheye_view,
    )
    if not outline.train:
        raise DataError("the dataset has no training views; check the folder of images")
    most = int(len(outline.train) / LEAST_CONTRIBUTION)  # a photo is in no more blocks than that
    if counts is not None and counts[0] * counts[1] > most:
        photos = len(outline.train)
        raise UsageError(f"--blocks: {photos} photos suffice for {most} blocks at most; give fewer")
    width = max(view.camera.width for view in outline.train)
    return config.for_dataset(outline.kind), width


def _coarse_and_plan(
    data: Path,
    folder: Path,
    config: TrainConfig,
    counts: tuple[int, int] | None,
    device: Device,
    memory: int | None,
    on_event: OnEvent,
) -> tuple[RunResult, Plan]:
    """The coarse scene, whose settings are ``config``, and the plan, made as far as they are not.

    ``counts`` rows and columns; None: as the ``memory`` of a worker asks for.
    """
    forget_peak_memory()
    idle = peak_memory() or 0
    photos = load_for(config, data, folder, lambda line: on_event(Note(line)))
    coarse = finished_run(folder / COARSE, photos, config)
    if coarse is None:
        on_event(Note(f"a coarse scene of all photos first, {config.steps} steps"))
        session = Session(photos, folder / COARSE, config, device, resume=True)
        coarse = session.run(lambda one: on_event(TrainingProgress(one, config.steps)))
    plan = read_plan(folder / BLOCKS)
    if plan is not None:
        return coarse, plan
    photos = repose(photos, coarse.scene.transform)
    advance = counter("looking at views", len(photos.train + photos.test), on_event)
    seen = look(device, coarse.scene, photos, config.render_options(), advance)
    if counts is None:
        if memory is None:
            raise UsageError(
                "--blocks auto: the system does not say how much memory is free; give NxM"
            )
        used = idle, int(coarse.summary["peak_memory_bytes"] or 0)
        whole = idle + int(GROWTH * max(0, used[1] - idle)) >> 20  # MiB
        fits = "; it fits without --blocks, too" if whole <= memory >> 20 else ""
        text = f"the whole would take about {whole} MiB at once; a worker has {memory >> 20}{fits}"
        on_event(Note(text))
        contribution = seen.contribution(len(coarse.scene.anchors))
        counts = counts_for_memory(coarse.scene, contribution, up_of(photos), used, memory)
    return coarse, make_plan(folder / BLOCKS, coarse.scene, photos, seen, counts)


def _follow(tasks: list[Task], on_event: OnEvent) -> Tell:
    """What receives the messages of workers and reports the steps of all blocks together."""
    total = sum(task["steps"] - task["begun"] for task in tasks)
    begun = {task["run"]: task["begun"] for task in tasks}
    done = dict.fromkeys(begun, 0)

    def follow(message: Message) -> None:
        name = message["run"]
        done[name] = max(done[name], message["step"] - begun[name])
        on_event(StageProgress("steps of all blocks", sum(done.values()), total))

    return follow
