"""What a worker does with a block: an ordinary run of its photos, in which its box learns."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from clgs.cluster.blocks.cuts import Cuts
from clgs.cluster.blocks.plan import START, Plan
from clgs.cluster.blocks.schedule import block_config
from clgs.cluster.worker import Reporter, Row, Task, Tell, forget_peak_memory, opened_device
from clgs.data.dataset import Dataset
from clgs.data.origin import repose
from clgs.errors import DataError
from clgs.memory import return_freed_memory
from clgs.opencl.device import Device
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import load_scene
from clgs.train.config import TrainConfig, from_toml
from clgs.train.run.load import load_for, state_of_scene
from clgs.train.run.run_folder import finished_run
from clgs.train.run.session import Progress, Session
from clgs.train.state.run_state import RunState

FIGURES = ("psnr", "split", "anchors", "train_seconds", "peak_memory_bytes")


def block_tasks(data: Path, folder: Path, config: TrainConfig, plan: Plan) -> list[Task]:
    """The tasks of all blocks of the run in ``folder``, whose settings are resolved.

    A task has run (ROW-COLUMN), data, points (folder that keeps those that were triangulated),
    folder, lock (paths), config (text of TOML), steps, begun (those done before), position_q, box
    (in scene units), train and test (names of photos).
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
    dataset = block_dataset(task, config, start)
    result = finished_run(folder, dataset, config)
    was_finished = result is not None
    if result is None:
        first = partial(block_state, device, dataset, start, task["begun"])

        def report(progress: Progress) -> None:
            reporter.progress(progress)

        result = Session(dataset, folder, config, device, resume=True, first=first).run(report)
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
    state.rate.scales, state.begun = start.scales, begun
    return state
