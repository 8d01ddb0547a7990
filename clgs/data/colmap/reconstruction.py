"""What pycolmap reads of a COLMAP model: names, cameras and poses of images, and points.

A process of its own reads it (``child``): pycolmap and its copy of all observations take 60 MB and
more, which training would carry along.
"""

from __future__ import annotations

import base64
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.colmap.binary_check import check_binary_model
from clgs.data.colmap.text_check import check_text_poses, explain_text_model
from clgs.poses.child import OnStage, run_child, serve
from clgs.poses.pycolmap_lazy import quiet_pycolmap

_REMEDY = "export the model again"


@dataclass(frozen=True)
class PosedImage:
    """name; world to camera as rotation (3, 3) and translation (3,), lists of float; camera.

    model is COLMAP's name of it, params are in its order, width and height in pixels.
    """

    name: str
    rotation: list[list[float]]
    translation: list[float]
    model: str
    params: list[float]
    width: int
    height: int


@dataclass(frozen=True)
class Reconstruction:
    """Images that have a pose; position (P, 3) float64 and color (P, 3) uint8, in order of ids."""

    images: list[PosedImage]
    position: npt.NDArray[np.float64]
    color: npt.NDArray[np.uint8]


def read_elsewhere(model: Path) -> Reconstruction:
    """As :func:`read`, in a process of its own.

    Raises:
        DataError: naming file, field and remedy.
    """
    plain = run_child(__name__, f"{model}", str(model), lambda told: None, _REMEDY)
    position = np.frombuffer(base64.b64decode(plain["position"]), np.float64)
    color = np.frombuffer(base64.b64decode(plain["color"]), np.uint8)
    images = [PosedImage(**image) for image in plain["images"]]
    return Reconstruction(images, position.reshape(-1, 3), color.reshape(-1, 3))


def main() -> None:
    """The process that reads."""
    serve(_work)


def _work(arguments: Any, on_stage: OnStage) -> dict[str, Any]:
    found = read(Path(arguments))
    return {
        "images": [asdict(image) for image in found.images],
        "position": base64.b64encode(found.position.tobytes()).decode(),
        "color": base64.b64encode(found.color.tobytes()).decode(),
    }


def read(model: Path) -> Reconstruction:
    """The model in a folder, which has all files of its form, binary or text.

    Raises:
        DataError: naming file, field and remedy.
    """
    binary = (model / "cameras.bin").is_file()
    if binary:
        check_binary_model(model)
    with quiet_pycolmap(f"{model}: unreadable COLMAP model") as pycolmap:
        reconstruction = pycolmap.Reconstruction()
        if binary:
            reconstruction.read_binary(str(model))
        else:
            _read_text(reconstruction, model)
        posed = [image for image in reconstruction.images.values() if image.has_pose]
        points = [point for _, point in sorted(reconstruction.points3D.items())]
        return Reconstruction(
            [_image(image) for image in posed],
            np.array([point.xyz for point in points], np.float64).reshape(-1, 3),
            np.array([point.color for point in points], np.uint8).reshape(-1, 3),
        )


def _read_text(reconstruction: Any, model: Path) -> None:
    """Fill ``reconstruction``; an error names file, line and field if they can be found."""
    check_text_poses(model)
    try:
        reconstruction.read_text(str(model))
    except Exception:
        explain_text_model(model)
        raise


def _image(image: Any) -> PosedImage:
    pose, camera = image.cam_from_world().matrix(), image.camera
    return PosedImage(
        image.name,
        pose[:, :3].tolist(),
        pose[:, 3].tolist(),
        camera.model_name,
        [float(value) for value in camera.params],
        int(camera.width),
        int(camera.height),
    )
