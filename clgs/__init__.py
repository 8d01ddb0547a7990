"""Vendor-neutral Gaussian splatting: training, compression and rendering on OpenCL.

The names of this module do the whole job; nothing heavy is imported before one is used.

- ``run(photos, output)``: all of it: poses, training, file, scores, page, clip and report
- ``prepare(photos, output)``: poses and points from a folder of photos (structure from motion)
- ``load_dataset(folder)``: Blender, transforms.json, COLMAP and other data with its views
- ``preset(name)``: a training configuration; ``.scaled(steps)`` sets the length
- ``train_scene(dataset, folder, config)``: a trained, quantised, encoded scene
- ``encode(scene)`` / ``decode(data)``: a scene to bytes and back, bit for bit
- ``export(scene, output)``: a scene as a web page, or as ordinary Gaussians
- ``save_scene(path, scene)`` / ``load_scene(path)``: a scene as a NumPy archive
- ``load_splats(path)``: ordinary 3DGS splats, to be rendered
- ``Renderer(device, scene)`` and ``render_view(scene, camera)``: pictures from any camera
- ``rasterization(means, quats, ...)``: pictures of your own Gaussians, with gradients; the
  arguments and results of gsplat, on NumPy arrays
- ``decode_anchors(scene, camera)``: the neural Gaussians of a view, with gradients by the scene
- ``evaluate_views(device, scene, views)``: PSNR and SSIM against photos
- ``render_options(accuracy)``: how exactly a ``Renderer`` renders, and how fast
- ``Camera``, ``Device``, ``TrainConfig``: what the functions above take
"""

from __future__ import annotations

import importlib
import sys
import warnings
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "Camera": "clgs.scene.camera",
    "Device": "clgs.opencl.device",
    "Renderer": "clgs.render.renderer",
    "TrainConfig": "clgs.train.config",
    "decode": "clgs.codec.scene_decoder",
    "decode_anchors": "clgs.render.decoded_anchors",
    "encode": "clgs.codec.scene_encoder",
    "evaluate_views": "clgs.train.quality.scores",
    "export": "clgs.workflow.export",
    "load_dataset": "clgs.data.dataset",
    "load_scene": "clgs.scene.storage",
    "load_splats": "clgs.data.splats.gaussians",
    "prepare": "clgs.poses.prepare",
    "preset": "clgs.train.config",
    "rasterization": "clgs.render.rasterization",
    "render_options": "clgs.options",
    "render_view": "clgs.render.renderer",
    "run": "clgs.workflow.runs.run",
    "save_scene": "clgs.scene.storage",
    "train_scene": "clgs.train.run.session",
}

__all__ = sorted(_HOMES)  # the list is made from the table above


def __getattr__(name: str) -> Any:
    """Import the module that holds ``name``, or that is called so, on first use (PEP 562)."""
    missing = AttributeError(f"module 'clgs' has no attribute {name!r}")
    if name.startswith("_"):
        raise missing
    _warn_of_order()
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    try:
        return importlib.import_module(f"clgs.{name}")
    except ModuleNotFoundError as error:
        if error.name == f"clgs.{name}":
            raise missing from None
        raise  # a package that it needs, such as PyTorch, is not installed


def _warn_of_order() -> None:
    """Warn if pycolmap was imported before Pillow, whose PNG writer then corrupts the heap."""
    loaded = {name: place for place, name in enumerate(sys.modules)}
    if "pycolmap" in loaded and loaded["pycolmap"] < loaded.get("PIL.Image", len(loaded)):
        warnings.warn(
            "pycolmap was imported before Pillow: saving a PNG may crash; import PIL.Image first",
            RuntimeWarning,
            stacklevel=3,
        )


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


_warn_of_order()
