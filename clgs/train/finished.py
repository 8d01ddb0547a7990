"""A run folder whose run is over: what it holds, and whether it is the run that is meant."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from clgs.data.dataset import Dataset
from clgs.errors import DataError
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import load_scene
from clgs.train.config import TrainConfig
from clgs.train.resume import run_digest

RESULTS = "results.json"
"""The last file of a run: a folder that has it is finished."""


@dataclass
class RunResult:
    """A finished run: its folder, the quantised scene, the bitstream and the summary."""

    folder: Path
    scene: QuantizedScene
    bitstream: bytes
    summary: dict[str, Any] = field(default_factory=dict)


def finished_run(folder: Path, dataset: Dataset, config: TrainConfig) -> RunResult | None:
    """What the run in ``folder`` gave; None where there is none, or it is not finished.

    Args:
        folder: run folder, may be missing.
        dataset: what the run must have been trained on.
        config: the settings that it must have had, resolved for ``dataset``.

    Raises:
        DataError: it is finished and had other settings or photos, or its files are damaged.
    """
    path = folder / RESULTS
    if not path.exists():
        return None
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        digest = summary["digest"]
        bitstream = (folder / "scene.clgs").read_bytes()
    except (ValueError, TypeError, KeyError, FileNotFoundError) as error:
        raise DataError(f"{folder}: a finished run, but damaged ({error}); name another") from error
    if digest != run_digest(dataset, replace(config, downscale=dataset.downscale)):
        raise DataError(
            f"{folder}: holds a finished run with other settings or photos; give the same options "
            "(config.toml lists them) or choose another run folder"
        )
    return RunResult(folder, load_scene(folder / "scene.npz"), bitstream, summary)
