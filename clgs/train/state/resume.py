"""Save and restore the whole state of a trainer, so that a resumed run gives the same bits."""

from __future__ import annotations

import hashlib
import zlib
from pathlib import Path
from typing import Any

import numpy.typing as npt

from clgs.data.dataset import Dataset
from clgs.ops.adam import Moments
from clgs.scene.anchors import AnchorSet
from clgs.train.config import TrainConfig
from clgs.train.density.grow_and_prune import Statistics
from clgs.train.run.trainer import Trainer
from clgs.train.state import checkpoint
from clgs.train.state.parameters import ANCHOR_GROUPS, download_anchors, upload_anchors
from clgs.train.step.schedule import ViewSampler

Arrays = dict[str, npt.NDArray[Any]]
ANCHOR_NAMES = ("position", *ANCHOR_GROUPS)
STATISTICS = ("opacity_sum", "visits", "gradient_sum", "gradient_count")


def save_checkpoint(folder: Path, trainer: Trainer) -> None:
    """Write everything that the next steps depend on."""
    device, parameters = trainer.device, trainer.parameters
    anchors, moments = download_anchors(device, parameters)
    statistics = trainer.densifier.download()
    arrays: Arrays = {name: getattr(anchors, name) for name in ANCHOR_NAMES}
    arrays |= {f"statistics.{name}": getattr(statistics, name) for name in STATISTICS}
    for name in ANCHOR_GROUPS:
        arrays[f"first.{name}"], arrays[f"second.{name}"] = moments[name]
    arrays["weights"] = device.download(parameters.scene.weights)
    arrays["first.weights"] = device.download(parameters.moments["weights"].first)
    arrays["second.weights"] = device.download(parameters.moments["weights"].second)
    scalars = {
        "step": trainer.steps_done,
        "merged": trainer.merged,
        "rng": trainer.rng.bit_generator.state,
        "sampler": trainer.sampler.state(),
    }
    checkpoint.save(folder, arrays, scalars, run_digest(trainer.dataset, trainer.config))


def load_checkpoint(folder: Path, trainer: Trainer) -> None:
    """Continue from the newest usable checkpoint.

    Raises:
        DataError: all are damaged, or belong to a run with other settings or photos.
    """
    arrays, scalars = checkpoint.load(folder, run_digest(trainer.dataset, trainer.config))
    device = trainer.device
    weights = device.upload(arrays["weights"])
    weight_moments = Moments(
        device.upload(arrays["first.weights"]), device.upload(arrays["second.weights"])
    )
    moments = {name: (arrays[f"first.{name}"], arrays[f"second.{name}"]) for name in ANCHOR_GROUPS}
    anchors = AnchorSet(*(arrays[name] for name in ANCHOR_NAMES))
    trainer.parameters = upload_anchors(device, anchors, moments, weights, weight_moments)
    trainer.densifier.restore(Statistics(*(arrays[f"statistics.{name}"] for name in STATISTICS)))
    trainer.rng.bit_generator.state = scalars["rng"]
    trainer.sampler = ViewSampler.restore(scalars["sampler"])
    trainer.merged = int(scalars["merged"])
    trainer.steps_done = int(scalars["step"])


def run_digest(dataset: Dataset, config: TrainConfig) -> str:
    """SHA-256 of the settings, the training photos, their cameras and the initial points."""
    digest = hashlib.sha256(config.digest().encode())
    for view in dataset.train:
        digest.update(f"{view.name} {view.image.shape}".encode())
        digest.update(zlib.crc32(view.image.tobytes()).to_bytes(4, "little"))
        digest.update(view.camera.pack(config.near).tobytes())
    digest.update(dataset.points.tobytes())
    return digest.hexdigest()
