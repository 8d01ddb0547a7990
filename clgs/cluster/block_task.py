"""What a worker does with a block: an ordinary run of its photos, in which its box learns.

A run in blocks has three parts: coarse scene, blocks, and all of it again. Their settings share the
steps, the learning rates and the growth of one run. A block does as many of the steps as it has of
the cameras, so that each of its anchors is seen as often as in that run.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from clgs.cluster.block_plan import START, Cuts, Plan
from clgs.cluster.worker import Reporter, Row, Task, Tell, forget_peak_memory, opened_device
from clgs.data.dataset import Dataset
from clgs.data.origin import repose
from clgs.data.reduction import LEAST_SIZE
from clgs.errors import DataError, UsageError
from clgs.machine import return_freed_memory
from clgs.opencl.device import Device
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import load_scene
from clgs.train.config import TrainConfig, from_toml
from clgs.train.config.option import options_of
from clgs.train.config.settings import FINE_Q
from clgs.train.config.size_settings import size_of
from clgs.train.run.load import load_for, state_of_scene
from clgs.train.run.run_folder import finished_run
from clgs.train.run.session import Session
from clgs.train.state.run_state import RunState

COARSE_SHARE = 0.25
"""Share of the steps that the coarse scene takes."""

COARSE_WIDTH = 400
"""Pixels: photos of the coarse scene are half as wide as others, but no narrower than this. From
narrower ones the MLPs learn too little for blocks, in which they rest.
"""

JOINT_SHARE = 0.8
"""The merged scene learns as a whole from this share of the steps before the switch to integers on,
so that it repairs between rounds what each of them leaves out.
"""

GROWING = ("statistics_start", "growth_start", "growth_end")

LEAST_STEPS = 10
"""Shorter runs have no room for three parts."""


def check_settings(config: TrainConfig) -> None:
    """Raise UsageError if a run of these settings cannot be cut in blocks."""
    if config.steps < LEAST_STEPS:
        raise UsageError(f"steps: {config.steps} are too few for --blocks; give {LEAST_STEPS}")
    if config.box:
        raise UsageError("--box: each block has a box of its own; leave out --box or --blocks")
    if config.exposure:
        raise UsageError("--exposure: a photo would have one in each block; leave out one of both")
    if config.batch > 1:
        raise UsageError("--batch: blocks are trained side by side; leave out --batch or --blocks")
    if config.adam == "visible":
        raise UsageError("--adam visible: blocks learn by adam = dense; leave it or --blocks out")


def coarse_config(config: TrainConfig, width: int) -> TrainConfig:
    """The settings of the coarse scene: photos at half their size if wide enough.

    ``config`` is resolved for the data set; ``width``: of its widest photo in pixels.
    """
    steps = round(COARSE_SHARE * config.steps)
    limits: dict[str, Any] = {"max_anchors": config.most_anchors, "target_size": 0}
    if config.downscale:
        times = 2 if width // 2 >= COARSE_WIDTH else 1
        return _unpriced(replace(config, **limits, downscale=times * config.downscale), steps)
    reduced = max(width // 2, min(width, COARSE_WIDTH), LEAST_SIZE)
    return _unpriced(replace(config, **limits, max_size=reduced), steps)


def block_config(config: TrainConfig, share: float, box: str) -> tuple[TrainConfig, int]:
    """The settings of a block, and the number of the last step that the coarse scene did for it.

    How many anchors it may have is not in them, see :func:`limited`. ``share``: of the cameras that
    the block has; ``box``: where anchors learn, as the setting says.
    """
    own = {
        name: max(one.least, round(share * getattr(config, name)))
        for name, one in options_of(TrainConfig).items()
        if one.scaled
    }
    own["growth_interval"] = max(1, round(share * config.growth_interval))
    begun = round(share * COARSE_SHARE * config.steps)
    steps = max(begun + 2, round(share * joint_begin(config)))
    own["steps"] = max(steps, round(share * config.steps))
    own["switch_step"] = own["freeze_step"] = own["steps"]
    grown = own["growth_end"] + own["growth_interval"]  # its statistics begin at zero
    own["growth_end"] = min(grown, own["steps"])
    priceless = replace(config, **own, target_size=0, max_anchors=0, box=box)
    return replace(_unpriced(priceless, steps), size_lambda=config.size_lambda), begun


def limited(config: TrainConfig, start: QuantizedScene, task: Task) -> TrainConfig:
    """The settings of a block that begins with ``start``, with its part of the task's limits.

    That is the part of the coarse scene's anchors that may learn in it; the others count, too.
    """
    box = config.learning_box
    assert box is not None
    inside = int(box.holds(start.dequantize().anchors.position).sum())
    others, part = len(start.anchors) - inside, inside / task["coarse"]

    def room(limit: int) -> int:
        return others + math.ceil(part * limit) if limit else 0

    target = size_of(room(task["held"]), config.mlp) if task["held"] else 0
    return replace(config, max_anchors=room(task["most"]), target_size=target)


def joint_begin(config: TrainConfig) -> int:
    """The number of the last step before the merged scene is trained as a whole.

    It leaves steps to each of the three parts.
    """
    begin = round(JOINT_SHARE * config.switch_step)
    return min(max(begin, round(COARSE_SHARE * config.steps) + 2), config.steps - 2)


def joint_config(config: TrainConfig) -> TrainConfig:
    """The settings of the merged scene: from the last steps before the switch to integers on."""
    begin = joint_begin(config)
    names = ("switch_step", "prune_end", "freeze_step", "mlp_switch_step")
    later = {name: max(begin, getattr(config, name)) for name in names}
    later["switch_step"] = min(later["switch_step"], config.steps - 1)
    growth = {name: min(getattr(config, name), begin) for name in GROWING}
    return replace(config, coarse_to_fine=False, **growth, **later)


def _unpriced(config: TrainConfig, steps: int) -> TrainConfig:
    """The first ``steps`` of a run, in which nothing is priced.

    Only the last of them is at integers, fine ones, for which positions move to their grid.
    """
    growth = {name: min(getattr(config, name), steps - 1) for name in GROWING}
    return replace(
        config,
        **growth,
        **{name: getattr(config, name) or q for name, q in FINE_Q.items()},
        steps=steps,
        switch_step=steps - 1,
        prune_end=steps,
        freeze_step=steps,
        mlp_switch_step=steps,
        mlp="float32",
        size_lambda=0.0,
        rate_weight=0.0,
        coarse_to_fine=False,
    )


FIGURES = ("psnr", "split", "anchors", "train_seconds", "peak_memory_bytes")


def block_tasks(
    data: Path, folder: Path, config: TrainConfig, plan: Plan, coarse: int
) -> list[Task]:
    """The tasks of all blocks of the run in ``folder``, whose settings are resolved.

    A task has run (ROW-COLUMN), data, points (folder that keeps those that were triangulated),
    folder, lock (paths), config (text of TOML), steps, begun (those done before), coarse (anchors
    of the coarse scene), held and most (anchors of the whole that a size asked for holds, and that
    there may be; 0: any number), train and test (names of photos).
    """
    most = len({name for names in plan.train.values() for name in names})
    tasks = []
    for number, name in enumerate(plan.cuts.names):
        box = box_text(plan.cuts, number, config.position_q)
        own, begun = block_config(config, len(plan.train[name]) / most, box)
        tasks.append(
            {
                "run": name,
                "data": str(data.resolve()),
                "points": str(folder.resolve()),
                "folder": str((folder / "blocks" / name).resolve()),
                "lock": str((folder / "blocks" / "locks" / name).resolve()),
                "config": own.to_toml(),
                "steps": own.steps,
                "begun": begun,
                "coarse": coarse,
                "held": config.held_anchors,
                "most": config.max_anchors,
                "train": plan.train[name],
                "test": plan.test[name],
            }
        )
    return tasks


def box_text(cuts: Cuts, block: int, position_q: float) -> str:
    """A block with its margin as the setting ``box``, scene units."""
    box = cuts.box(block, margin=True)
    return ",".join(repr(side / position_q) for side in (*box.lower, *box.upper))


def train_block(task: Task, tell: Tell = lambda message: None) -> Row:
    """Train a block, or go on with it; its row.

    Raises:
        ClgsError, OSError: as :func:`clgs.train_scene`.
    """
    return_freed_memory()
    forget_peak_memory()
    reporter = Reporter(task["run"], task["steps"], tell)
    reporter.now("reading photos")
    folder, device = Path(task["folder"]), opened_device(task.get("device"))
    config = from_toml(task["config"], f"block {task['run']}")
    start = load_scene(folder / START)
    config = limited(config, start, task)
    dataset = block_dataset(task, config, start)
    result = finished_run(folder, dataset, config)
    was_finished = result is not None
    if result is None:
        first = partial(block_state, device, dataset, start, task["begun"])
        session = Session(dataset, folder, config, device, resume=True, first=first)
        result = session.run(reporter.progress)
    figures = {name: result.summary[name] for name in FIGURES if name in result.summary}
    return {"run": task["run"], "was_finished": was_finished, **figures}


def block_dataset(task: Task, config: TrainConfig, start: QuantizedScene) -> Dataset:
    """The photos of the block, in the units of ``start``.

    Raises:
        DataError: as :func:`clgs.train.run.load.load_for`, or a photo is missing.
    """
    whole = load_for(config, task["data"], Path(task["points"]))
    dataset = repose(whole, start.transform)
    parts: dict[str, Any] = {}
    for split in ("train", "test"):
        by_name = {view.name: view for view in getattr(dataset, split)}
        if lacking := [name for name in task[split] if name not in by_name]:
            raise DataError(
                f"{task['data']}: lacks the photo {lacking[0]}, which it had; restore it"
            )
        parts[split] = [by_name[name] for name in task[split]]
    return replace(dataset, **parts)


def block_state(
    device: Device, dataset: Dataset, start: QuantizedScene, begun: int, config: TrainConfig
) -> RunState:
    """The state of a run that goes on with ``start`` after step number ``begun``."""
    state = state_of_scene(device, dataset, config, start.dequantize(), begun)
    state.rate.scales = start.scales
    return state
