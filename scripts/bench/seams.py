"""PSNR near the borders of blocks, of a scene that was trained in blocks and of one trained whole.

``python scripts/bench/seams.py WHOLE BLOCKS``, two run folders of the same photos at the same size:
all held-out pixels that show something nearer to a border than the margin of blocks, and all
others. What a pixel shows is where the depth of the whole scene is.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.cluster.block_plan import Cuts, read_plan
from clgs.codec.scene_decoder import decode
from clgs.opencl.device import Device
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.train.quality.scores import to_8bit, with_photos
from clgs.train.run.run_folder import BLOCKS
from clgs.workflow.options import ViewOptions
from clgs.workflow.views import drawing_options, select_views

Floats = npt.NDArray[np.float64]

OPAQUE = 0.5
"""Pixels with less opacity show no place."""


def shown_places(camera: Camera, depth: Floats) -> Floats:
    """(H, W, 3): the place that each pixel shows at ``depth`` (H, W), scene units."""
    rows, columns = np.indices(depth.shape) + 0.5
    ray = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy], -1)
    seen = np.concatenate([ray, np.ones((*depth.shape, 1))], -1) * depth[..., None]
    return np.asarray((seen - camera.translation) @ camera.rotation)


def near_border(cuts: Cuts, place: Floats) -> npt.NDArray[np.bool_]:
    """Whether each place (H, W, 3), in integers of the grid, is in the margin of a border."""
    first, second = (place[..., axis] for axis in cuts.axes)
    near = np.zeros(first.shape, np.bool_)
    for cut in cuts.rows:
        near |= np.abs(first - cut) < cuts.margin[0]
    row = np.searchsorted(cuts.rows, first)
    for number, columns in enumerate(cuts.columns):
        for cut in columns:
            near |= (row == number) & (np.abs(second - cut) < cuts.margin[1])
    return near


def main() -> None:
    """Print a line per part of the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("whole", type=Path)
    parser.add_argument("blocks", type=Path)
    args = parser.parse_args()
    device, options = Device(None), ViewOptions(split="test")
    files = [run / "scene.clgs" for run in (args.whole, args.blocks)]
    for file in files:
        if not file.is_file():
            raise SystemExit(f"{file}: no such file; name the folder of a finished run")
    plan = read_plan(args.blocks / BLOCKS)
    if plan is None:
        raise SystemExit(f"{args.blocks}: was not trained in blocks; name a run of --blocks")
    scenes = [decode(file.read_bytes()) for file in files]
    views = select_views(files[0], scenes[0], options)
    renderers = [
        Renderer(device, scene.dequantize(), drawing_options(file, options, scene))
        for file, scene in zip(files, scenes, strict=True)
    ]
    scale = scenes[1].scales.position
    squared: dict[str, list[npt.NDArray[np.float64]]] = {"border": [], "elsewhere": []}
    for view, planes in with_photos(views, scenes[0].settings.background):
        photo = planes.transpose(1, 2, 0) / 255.0
        pictures = [to_8bit(renderer.render(view.camera)) / 255.0 for renderer in renderers]
        errors = np.stack([np.square(picture - photo).mean(-1) for picture in pictures], -1)
        found = renderers[0].depth(view.camera)
        place = shown_places(view.camera, found.depth.astype(np.float64))
        near = near_border(plan.cuts, place * scale) & (found.opacity > OPAQUE)
        squared["border"].append(errors[near])
        squared["elsewhere"].append(errors[~near])
    for name, parts in squared.items():
        pixels = np.concatenate(parts)
        whole, blocks = -10 * np.log10(pixels.mean(0))
        print(f"{name}: {len(pixels):,} pixels, whole {whole:.2f} dB, blocks {blocks:.2f} dB")


if __name__ == "__main__":
    main()
