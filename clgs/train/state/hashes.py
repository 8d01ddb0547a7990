"""The two fingerprints of a run.

:func:`run_digest` says what a run is made of: settings and data. Checkpoints and results carry it,
so that a run is resumed only with what it began with. :func:`fingerprint` says what a run has made:
the scene's integers and some of its renders, as proof that decoding gives the same bits.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.dataset import Dataset
from clgs.data.images import MAX_PIXELS
from clgs.errors import DataError
from clgs.opencl.device import Device
from clgs.options import PRESETS, render_options
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene
from clgs.train.config import TrainConfig

CAMERA_NUMBERS = ("fx", "fy", "cx", "cy", "width", "height")

MAX_NUMBER = 1e12
MIN_FOCAL = 1e-6
"""Limits of a camera's numbers, so that float32 holds everything that follows from them."""


def run_digest(dataset: Dataset, config: TrainConfig) -> str:
    """SHA-256 of the settings, the training photos, their cameras and the initial points."""
    digest = hashlib.sha256(config.digest().encode())
    for view in dataset.train:
        shape = view.camera.height, view.camera.width, 3
        digest.update(f"{view.name} {shape}".encode(errors="surrogateescape"))
        digest.update(view.photo.checksum().to_bytes(4, "little"))
        if (used := view.used()) is not None:
            digest.update(used.tobytes())
        digest.update(view.camera.pack(config.near).tobytes())
    digest.update(dataset.points.tobytes())
    return digest.hexdigest()


def scene_hash(scene: QuantizedScene) -> str:
    """SHA-256 of the integers (little-endian int32, Morton order) and of the MLP weights."""
    digest = hashlib.sha256()
    for _, array in scene.anchors.items():
        digest.update(np.ascontiguousarray(array, "<i4").tobytes())
    digest.update(np.ascontiguousarray(scene.mlps.flat, "<f4").tobytes())
    return digest.hexdigest()


def render_hashes(
    device: Device, scene: QuantizedScene, cameras: list[Camera], accuracy: str
) -> list[str]:
    """SHA-256 of every render's float32 values (little-endian, (3, H, W))."""
    renderer = Renderer(device, scene.dequantize(), render_options(accuracy))
    return [
        hashlib.sha256(renderer.render(camera).astype("<f4").tobytes()).hexdigest()
        for camera in cameras
    ]


def fingerprint(
    device: Device, scene: QuantizedScene, cameras: list[Camera], accuracy: str = "parity"
) -> dict[str, Any]:
    """Hashes of the scene and of ``cameras``' renders, with the cameras, ready for JSON."""
    return {
        "device": device.name,
        "scene": scene_hash(scene),
        "accuracy": accuracy,
        "renders": render_hashes(device, scene, cameras, accuracy),
        "cameras": [
            {
                "rotation": camera.rotation.tolist(),
                "translation": camera.translation.tolist(),
                **{name: getattr(camera, name) for name in CAMERA_NUMBERS},
            }
            for camera in cameras
        ],
    }


def read_fingerprint(path: Path) -> dict[str, Any]:
    """What :func:`fingerprint` made, from a JSON file.

    Raises:
        DataError: the file is missing or is no such file.
    """
    try:
        expected = json.loads(path.read_text(encoding="utf-8"))
        _read_cameras(expected)
        return dict(expected)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; `clgs train` writes hashes.json") from None
    except IsADirectoryError:
        raise DataError(f"{path}: is a folder; name the hashes.json in it") from None
    except RecursionError:
        raise DataError(f"{path}: not a hashes.json (nested too deep)") from None
    except ValueError as error:
        raise DataError(f"{path}: not a hashes.json ({error})") from None


def differences(device: Device, scene: QuantizedScene, expected: dict[str, Any]) -> list[str]:
    """The parts of a fingerprint that ``scene`` does not reproduce on ``device``; empty if none.

    Raises:
        ValueError: ``expected`` is no fingerprint.
    """
    cameras = _read_cameras(expected)
    found = [] if scene_hash(scene) == expected["scene"] else ["quantised integers"]
    actual = render_hashes(device, scene, cameras, expected.get("accuracy", "parity"))
    for index, (mine, theirs) in enumerate(zip(actual, expected["renders"], strict=True)):
        if mine != theirs:
            found.append(f"render {index}")
    return found


def _read_cameras(expected: Any) -> list[Camera]:
    """The cameras of a fingerprint; raises ValueError if anything in it makes no sense."""
    if not isinstance(expected, dict):
        raise ValueError("no JSON object")
    renders, cameras = expected.get("renders"), expected.get("cameras")
    if not (isinstance(renders, list) and isinstance(cameras, list) and cameras):
        raise ValueError("renders and cameras must be lists that are not empty")
    if len(renders) != len(cameras):
        raise ValueError(f"{len(renders)} renders of {len(cameras)} cameras")
    if expected.get("accuracy", "parity") not in list(PRESETS):
        raise ValueError(f"accuracy must be one of {', '.join(PRESETS)}")
    for digest in (expected.get("scene"), *renders):
        if not (isinstance(digest, str) and re.fullmatch("[0-9a-f]{64}", digest)):
            raise ValueError("scene and renders must be SHA-256 in hexadecimal")
    return [_camera(record, f"camera {index}") for index, record in enumerate(cameras)]


def _camera(record: Any, source: str) -> Camera:
    if not isinstance(record, dict):
        raise ValueError(f"{source}: no JSON object")
    lens = {name: float(_array(record, name, (), source)) for name in ("fx", "fy", "cx", "cy")}
    if not min(lens["fx"], lens["fy"]) >= MIN_FOCAL:
        raise ValueError(f"{source}: fx and fy must be positive")
    width, height = record.get("width"), record.get("height")
    if type(width) is not int or type(height) is not int:
        raise ValueError(f"{source}: width and height must be whole numbers")
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise ValueError(f"{source}: {width} x {height} pixels")
    rotation = _array(record, "rotation", (3, 3), source)
    translation = _array(record, "translation", (3,), source)
    return Camera(rotation, translation, **lens, width=width, height=height)


def _array(
    record: dict[str, Any], name: str, shape: tuple[int, ...], source: str
) -> npt.NDArray[np.float64]:
    """Field ``name`` as float64; float32 must be able to hold it."""
    try:
        array = np.array(record.get(name))
    except ValueError:
        array = np.array(None)
    if array.shape != shape or array.dtype.kind not in "iuf":
        wanted = f"{' x '.join(map(str, shape))} numbers" if shape else "a number"
        raise ValueError(f"{source}: {name} must be {wanted}")
    if not (np.abs(array) <= MAX_NUMBER).all():
        raise ValueError(f"{source}: {name} is not finite, or too large")
    return array.astype(np.float64)
