"""A quantised scene as a NumPy archive: exact, readable without this package, no pickles."""

from __future__ import annotations

import io
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from clgs.errors import DataError
from clgs.files import atomic_write
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.scene import QuantizedScene, RenderSettings, SceneTransform

ANCHOR_NAMES = ("position", "offset", "feature", "scaling")


def save_scene(path: Path, scene: QuantizedScene) -> None:
    """Write integers, float32 MLP weights and settings to ``path`` (.npz), atomically.

    For readers without this package it also holds ``world_position`` (A, 3) float64, the anchor
    positions in the units of the input data.
    """
    arrays: dict[str, Any] = {name: getattr(scene.anchors, name) for name in ANCHOR_NAMES}
    arrays["mlps"] = scene.mlps.flat
    for group in ("scales", "settings", "transform"):
        for name, value in asdict(getattr(scene, group)).items():
            arrays[f"{group}.{name}"] = np.array(value, np.float64)
    position = scene.anchors.position / np.float64(scene.scales.position)
    arrays["world_position"] = scene.transform.to_world(position)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    atomic_write(path, buffer.getvalue())


def load_scene(path: Path) -> QuantizedScene:
    """Read what :func:`save_scene` wrote.

    Raises:
        DataError: the file is missing, damaged or lacks an array.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return _scene(arrays)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; train first or name a .clgs file") from None
    except KeyError as error:
        raise DataError(f"{path}: array {error} is missing; write the file again") from None
    except (ValueError, TypeError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise DataError(f"{path}: not a scene archive ({error}); write the file again") from None


def _scene(arrays: dict[str, Any]) -> QuantizedScene:
    if arrays["mlps"].shape != (MLP_SIZE,) or arrays["mlps"].dtype != np.float32:
        raise ValueError(f"mlps: expected ({MLP_SIZE},) float32")

    def group(name: str) -> dict[str, Any]:
        chosen = {k.partition(".")[2]: v for k, v in arrays.items() if k.startswith(f"{name}.")}
        return {
            k: float(v) if v.ndim == 0 else tuple(float(x) for x in v) for k, v in chosen.items()
        }

    return QuantizedScene(
        QuantizedAnchors(*(arrays[name] for name in ANCHOR_NAMES)),
        Mlps(arrays["mlps"]),
        QuantizationScales(**group("scales")),
        RenderSettings(**group("settings")),
        SceneTransform(**group("transform")),
    )
