"""Prints one SHA-256: what a device computes, for comparison between processes.

    python -m tests.stress.hash_worker FOLDER WHAT SPECIALISATION GROUP_SIZE STEPS

FOLDER holds the data set of ``tests.small_scene``; WHAT is "gradients" or "training".
"""

from __future__ import annotations

import hashlib
import importlib
import pkgutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import clgs.opencl.grid
import clgs.ops
from clgs.data.dataset import load_dataset
from clgs.lab.scenes import anchor_scene
from clgs.opencl.device import Device
from clgs.ops import loss
from clgs.render.frame import upload_scene, upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.scene.scene import RenderSettings
from clgs.train.config import preset
from clgs.train.run.load import with_points
from clgs.train.run.trainer import Trainer

NORMAL_GROUP = 64


def set_group_size(size: int, specialisation: str = "cpu") -> list[str]:
    """Work-groups of ``size`` in every op that leaves theirs open; returns those ops."""
    changed = []
    for module in pkgutil.iter_modules(clgs.ops.__path__):
        op = importlib.import_module(f"clgs.ops.{module.name}")
        # other sizes are compiled into the kernels; so is that of the MLPs' GPU form
        compiled = specialisation == "gpu" and module.name == "mlp"
        if getattr(op, "GROUP_SIZE", None) == NORMAL_GROUP and not compiled:
            op.GROUP_SIZE = size  # type: ignore[attr-defined]
            changed.append(module.name)
        elif hasattr(op, "by_lanes") or hasattr(op, "by_items"):
            changed.append(module.name)
    clgs.opencl.grid.ANY_GROUP = size
    clgs.opencl.grid.GROUP_SIZE = dict.fromkeys(clgs.opencl.grid.GROUP_SIZE, size)
    return changed


def gradients(device: Device, repeats: int) -> list[Any]:
    """Image, loss and gradients of a scene of 2,000 Gaussians; all repeats."""
    scene, camera = anchor_scene(2000, 70, 3)
    uploaded = upload_scene(device, scene)
    target = device.upload(np.random.default_rng(0).integers(0, 256, (3, 70, 70)).astype(np.uint8))
    found: list[Any] = []
    for _ in range(repeats):
        frame = rasterise(
            device,
            uploaded,
            upload_view(device, camera, RenderSettings(background=(0.1, 0.2, 0.3))),
        )
        compared = loss.forward(device, frame.image, target)
        d_image = loss.backward(device, frame.image, target, compared)
        result = rasterise_backward(device, uploaded, frame, d_image, 0.01)
        names = ("d_offset", "d_feature", "d_scaling", "d_weights", "d_mean2d")
        one = [frame.image, *(getattr(result, name) for name in names)]
        found.append(b"".join(device.download(array).tobytes() for array in one))
    if len(set(found)) != 1:
        raise SystemExit("repeats in one process differ")
    return found[:1]


def training(device: Device, folder: Path, steps: int) -> list[Any]:
    """Parameters, moments and every step's report after ``steps`` steps."""
    whole = with_points(load_dataset(folder))
    dataset = replace(whole, points=whole.points[::25])
    # growth, quantisation and rate proxy all happen within half of the steps
    config = replace(preset("default").scaled(steps), voxel=0.02).for_dataset(dataset.kind)
    trainer = Trainer(device, dataset, config)
    found: list[Any] = [repr(trainer.step()).encode() for _ in range(steps)]
    scene, moments = trainer.parameters.scene, trainer.parameters.moments
    found += [device.download(array).tobytes() for _, array in scene.items()]
    for pair in moments.values():
        found += [device.download(array).tobytes() for array in (pair.first, pair.second)]
    return found


def main() -> None:
    folder, what, specialisation, group, steps = sys.argv[1:]
    set_group_size(int(group), specialisation)
    device = Device(specialisation=specialisation)
    if what == "gradients":
        found = gradients(device, int(steps))
    else:
        found = training(device, Path(folder), int(steps))
    print(hashlib.sha256(b"".join(found)).hexdigest())


if __name__ == "__main__":
    main()
