"""Save and restore the whole state of a trainer, so that a resumed run gives the same bits."""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path

from clgs.data.dataset import Dataset
from clgs.opencl.array import DeviceArray
from clgs.ops.adam import Moments
from clgs.ops.density import DeviceStatistics, Statistics
from clgs.render.frame import DeviceScene
from clgs.scene.anchors import FIELDS, Anchors
from clgs.train.config import TrainConfig
from clgs.train.config.describe import describe
from clgs.train.config.option import options_of
from clgs.train.run.trainer import Trainer
from clgs.train.state import checkpoint
from clgs.train.state.parameters import ANCHOR_GROUPS, Parameters
from clgs.train.step.schedule import ViewSampler

SETTINGS = "config.toml"
"""The first file of a run."""

SHOWN = 3
"""Settings that a message tells at most."""


def save_checkpoint(folder: Path, trainer: Trainer) -> None:
    """Write everything that the next steps depend on."""
    trainer.compact()
    trainer.device.release_unused()
    arrays = _by_name(trainer.parameters, trainer.densifier.statistics)
    if trainer.queue.exposures is not None:
        arrays |= dict(trainer.queue.exposures.items())
    scalars = {
        "step": trainer.steps_done,
        "merged": trainer.merged,
        "rng": trainer.rng.bit_generator.state,
        "sampler": trainer.sampler.state(),
    }
    host = {name: trainer.device.download(array) for name, array in arrays.items()}
    host |= trainer.queue.rate.state() | trainer.economy.state()
    checkpoint.save(folder, host, scalars, run_digest(trainer.dataset, trainer.config))


def load_checkpoint(folder: Path, trainer: Trainer) -> None:
    """Continue from the newest usable checkpoint.

    Raises:
        DataError: all are damaged, or belong to a run with other settings or photos.
    """
    digest = run_digest(trainer.dataset, trainer.config)
    changed = changed_settings(folder.parent, trainer.config)
    host, scalars = checkpoint.load(folder, digest, changed)
    trainer.queue.rate.restore(host)
    trainer.economy.restore(host)
    on_host = ("rate.", "known.")
    arrays = {n: trainer.device.upload(a) for n, a in host.items() if not n.startswith(on_host)}
    scene = DeviceScene(Anchors(*(arrays[name] for name in FIELDS)), arrays["weights"])
    moments = {
        name: Moments(arrays[f"first.{name}"], arrays[f"second.{name}"])
        for name in (*ANCHOR_GROUPS, "weights")
    }
    trainer.parameters = Parameters(scene, moments)
    if trainer.queue.exposures is not None:
        trainer.queue.exposures.restore(arrays)
    trainer.densifier.statistics = Statistics(
        *(arrays[f"statistics.{name}"] for name, _ in trainer.densifier.statistics.items())
    )
    trainer.rng.bit_generator.state = scalars["rng"]
    trainer.sampler = ViewSampler.restore(scalars["sampler"])
    trainer.merged = int(scalars["merged"])
    trainer.steps_done = int(scalars["step"])


def changed_settings(folder: Path, config: TrainConfig) -> str:
    """What ``config`` has other than the run in ``folder``: " (--steps: 300 there, 400 here)".

    Nothing if that cannot be told, or if no setting that results depend on differs.
    """
    try:
        there = tomllib.loads((folder / SETTINGS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return ""
    here = tomllib.loads(config.to_toml())
    options = options_of(TrainConfig)
    kept = [name for name, one in options.items() if one.in_digest]
    names = [name for name in kept if there.get(name) != here.get(name)]
    if "steps" in names:
        names = ["steps"]  # most others follow from them
    told = [
        f"{describe(options[name]).flag}: {there.get(name)} there, {here.get(name)} here"
        for name in names[:SHOWN]
    ]
    return f" ({'; '.join(told)})" if told else ""


def _by_name(parameters: Parameters, statistics: DeviceStatistics) -> dict[str, DeviceArray]:
    """Every array of a run under the name that it has in a checkpoint."""
    moments = {
        f"{which}.{name}": array
        for name, pair in parameters.moments.items()
        for which, array in pair.items()
    }
    sums = {f"statistics.{name}": array for name, array in statistics.items()}
    return {**dict(parameters.scene.items()), **moments, **sums}


def run_digest(dataset: Dataset, config: TrainConfig) -> str:
    """SHA-256 of the settings, the training photos, their cameras and the initial points."""
    digest = hashlib.sha256(config.digest().encode())
    for view in dataset.train:
        shape = view.camera.height, view.camera.width, 3
        digest.update(f"{view.name} {shape}".encode())
        digest.update(view.photo.checksum().to_bytes(4, "little"))
        if (used := view.used()) is not None:
            digest.update(used.tobytes())
        digest.update(view.camera.pack(config.near).tobytes())
    digest.update(dataset.points.tobytes())
    return digest.hexdigest()
