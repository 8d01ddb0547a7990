"""Fingerprints of a scene and of its renders: proof that decoding gives the same bits."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from clgs.opencl.device import Device
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import ANCHOR_NAMES


def scene_hash(scene: QuantizedScene) -> str:
    """SHA-256 of the integers (little-endian int32, Morton order) and of the MLP weights."""
    digest = hashlib.sha256()
    for name in ANCHOR_NAMES:
        digest.update(np.ascontiguousarray(getattr(scene.anchors, name), "<i4").tobytes())
    digest.update(np.ascontiguousarray(scene.mlps.flat, "<f4").tobytes())
    return digest.hexdigest()


def render_hashes(device: Device, scene: QuantizedScene, cameras: list[Camera]) -> list[str]:
    """SHA-256 of every render's float32 values (little-endian, (3, H, W))."""
    renderer = Renderer(device, scene.dequantize())
    return [
        hashlib.sha256(renderer.render(camera).astype("<f4").tobytes()).hexdigest()
        for camera in cameras
    ]


def fingerprint(device: Device, scene: QuantizedScene, cameras: list[Camera]) -> dict[str, Any]:
    """Hashes of the scene and of ``cameras``' renders, with the cameras, ready for JSON."""
    return {
        "device": device.name,
        "scene": scene_hash(scene),
        "renders": render_hashes(device, scene, cameras),
        "cameras": [_camera_record(camera) for camera in cameras],
    }


def differences(device: Device, scene: QuantizedScene, expected: dict[str, Any]) -> list[str]:
    """What of a fingerprint ``scene`` does not reproduce on ``device``; empty when all agrees."""
    found = [] if scene_hash(scene) == expected["scene"] else ["quantised integers"]
    cameras = [_camera(record) for record in expected["cameras"]]
    actual = render_hashes(device, scene, cameras)
    for index, (mine, theirs) in enumerate(zip(actual, expected["renders"], strict=True)):
        if mine != theirs:
            found.append(f"render {index}")
    return found


def _camera_record(camera: Camera) -> dict[str, Any]:
    plain = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    return {
        "rotation": camera.rotation.tolist(),
        "translation": camera.translation.tolist(),
        **plain,
    }


def _camera(record: dict[str, Any]) -> Camera:
    pose = {name: np.array(record[name], np.float64) for name in ("rotation", "translation")}
    return Camera(**{**record, **pose})
