"""Train a tiny scene for one step: race_scene.py DEVICE SPECIALISATION [--step].

Every kernel that training and rendering launch runs, those of rounding and rate proxy after the
step: no step has both them and the statistics for growing, and a step takes up to a minute. Then
the other builds of the rasteriser, which presets of accuracy ask for, forward and backward; lists
that lack room; and a list that is staged batch after batch. With --step these three are left out.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from clgs.constants import TILE_SIZE
from clgs.lab.scenes import anchor_scene
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, cull, rate, tiles
from clgs.ops.project import Projected
from clgs.options import RenderOptions, render_options
from clgs.render import tile_groups
from clgs.render.frame import upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.scene.camera import Camera
from clgs.train.config import TrainConfig
from clgs.train.run.load import state_of_scene
from clgs.train.run.trainer import Trainer
from clgs.train.state.rounding import rounded_anchors
from clgs.train.state.run_state import ANCHOR_GROUPS
from clgs.workflow.runs.clocks import photo_dataset

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.gaussians import projected_scene

GAUSSIANS = 70
"""About; from 18 anchors, one full lane vector and one that is not."""
SIZE = 24
"""Four tiles, three of which reach beyond the image."""
DEEP = 320
"""Gaussians of a single tile: most of them, more than the 256 of a batch, are in its list."""


class ExactDevice(Device):
    """Gives every array a buffer of just its size; the pool rounds up and hides overruns."""

    def empty(self, shape: Sequence[int], dtype: npt.DTypeLike = np.float32) -> DeviceArray:
        """Uninitialised array."""
        dtype = np.dtype(dtype)
        nbytes = max(int(np.prod(shape)), 1) * dtype.itemsize
        buffer = cl.Buffer(self.context, cl.mem_flags.READ_WRITE, nbytes)
        return DeviceArray(buffer, tuple(shape), dtype)


def main(name: str, specialisation: str, only: str = "") -> int:
    """Exit code 1 if the loss or the rate is not a number."""
    scene, camera = anchor_scene(GAUSSIANS, SIZE, seed=1)
    config = replace(TrainConfig(), statistics_start=0).for_dataset("photos")
    device = ExactDevice(name, specialisation)
    dataset = photo_dataset(camera, scene.anchors.position)
    state = state_of_scene(device, dataset, config, scene, 0)
    trainer = Trainer(device, dataset, config, state=state)
    result = trainer.step()
    bits = rate_of_rounded(trainer)
    print(f"race_scene: {specialisation}: {result}, {bits} bits per anchor")
    if only == "--step":
        return 0 if np.isfinite(result.loss + bits) else 1
    largest = max(gradient_by_preset(trainer, camera, name) for name in ("exact", "fast"))
    without_room(trainer, camera)
    deep_tile(device)
    return 0 if np.isfinite(result.loss + bits + largest) else 1


def gradient_by_preset(trainer: Trainer, camera: Camera, preset: str) -> float:
    """Render with another truncation, and go back; largest gradient of the features."""
    device, scene = trainer.device, trainer.parameters.scene
    options = render_options(preset)
    frame = rasterise(device, scene, upload_view(device, camera, trainer.settings), options)
    d_image = device.upload(np.ones(frame.image.shape, np.float32))
    gradients = rasterise_backward(device, scene, frame, d_image)
    return float(np.abs(device.download(gradients.d_feature)).max())


def without_room(trainer: Trainer, camera: Camera) -> None:
    """Too little room for anchors and for entries; then groups of a row of tiles each."""
    device, scene = trainer.device, trainer.parameters.scene
    frame = rasterise(device, scene, upload_view(device, camera, trainer.settings))
    cull.forward(device, scene.anchors, frame.view.camera, room=1)
    drawn, size = frame.projected, (SIZE, SIZE)
    entries = len(frame.tiles.gaussian)
    for room in (0, entries - 1, entries + 1):
        tiles.forward(device, drawn, size, room=room)
    by_row = tiles.count_by_row(device, drawn, size)
    entry = tile_groups.LIST_BYTES[device.specialisation] + tile_groups.BYTES_BY_ENTRY
    options = RenderOptions(max_memory=int(by_row.max()) * entry)
    grouped = rasterise(device, scene, upload_view(device, camera, trainer.settings), options)
    rasterise_backward(device, scene, grouped, device.zeros(frame.image.shape))
    device.finish()


def deep_tile(device: Device) -> None:
    """Blend a list of several batches, forward and backward; small Gaussians, to be quick."""
    scene = projected_scene(np.random.default_rng(0), DEEP, TILE_SIZE, TILE_SIZE, 0.6)
    drawn = Projected(**{name: device.upload(array) for name, array in vars(scene).items()})
    lists = tiles.forward(device, drawn, (TILE_SIZE, TILE_SIZE))
    assert len(lists.gaussian) > 256
    blended = blend.forward(device, drawn, lists, device.zeros((3,)))
    blend.backward(device, drawn, blended, device.zeros(blended.image.shape))
    device.finish()


def rate_of_rounded(trainer: Trainer) -> float:
    """Round the parameters, run the rate proxy forward and backward; bits per anchor."""
    scales = trainer.state.rate.scales
    rounded = rounded_anchors(trainer.device, trainer.parameters.scene.anchors, scales)
    bits = 0.0
    for name in ANCHOR_GROUPS:
        x = getattr(rounded, name)
        result = rate.forward(trainer.device, x, getattr(scales, name))
        slopes = rate.slopes(trainer.device, result, 1.0)
        rate.backward(trainer.device, [(slopes, x, trainer.device.zeros(x.shape))])
        bits += result.bits
    return bits


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
