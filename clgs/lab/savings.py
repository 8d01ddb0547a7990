"""How much work the skips save, counted on one view of a training run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from clgs.lab.observed_kernels import PairCounts, count_pairs, mlp_work
from clgs.opencl.device import Device
from clgs.ops import adam, blend, tiles
from clgs.options import RenderOptions
from clgs.render.frame import Frame
from clgs.render.rasterise import rasterise_backward
from clgs.train.config import TrainConfig
from clgs.train.run.trainer import Trainer
from clgs.workflow.train import Saving


def savings(trainer: Trainer) -> list[Saving]:
    """Count on the first training view, with the parameters as they are; renders it again."""
    frame = trainer.render_next()
    return [
        *_of_anchors(trainer, frame),
        *_of_tiles(trainer.device, frame),
        *_of_pairs(trainer.device, frame),
        *_of_updates(trainer, frame),
        _of_rate(trainer.config),
    ]


def _of_anchors(trainer: Trainer, frame: Frame) -> Iterator[Saving]:
    work = mlp_work(trainer.device, frame.activations)
    yield Saving("anchors", "anchors decoded", work.all_samples, trainer.parameters.count)
    yield Saving("opacity_first", "anchors with color", work.samples, work.all_samples)
    yield Saving("slots", "rows of color and shape", work.rows, work.all_rows)


def _of_tiles(device: Device, frame: Frame) -> Iterator[Saving]:
    options = _without(frame.blended.options, "exact_tiles")
    boxes = tiles.forward(device, frame.projected, frame.view.size, options)
    found = int(device.download(frame.tiles.total)[0])
    yield Saving("exact_tiles", "tile entries", found, int(device.download(boxes.total)[0]))
    filled = np.diff(device.download(frame.tiles.tile_range)) > 0
    yield Saving("empty_tiles", "tiles", int(filled.sum()), len(filled))


def _of_pairs(device: Device, frame: Frame) -> Iterator[Saving]:
    """Pairs of pixel and Gaussian; blended ones are what no skip can save."""
    options = frame.blended.options
    forward, backward = _pairs(device, frame, options)
    for skip, index in (("units", 0), ("finished", 0), ("contributors", 1)):
        plain = _pairs(device, frame, _without(options, skip))[index]
        done = (forward, backward)[index]
        unit = f"pairs visited, {('forward', 'backward')[index]}"
        yield Saving(skip, unit, done.visited, plain.visited)
    yield Saving("(bound)", "pairs blended of visited", forward.blended, forward.visited)


def _pairs(device: Device, frame: Frame, options: RenderOptions) -> tuple[PairCounts, PairCounts]:
    background = frame.view.background
    blended = blend.forward(device, frame.projected, frame.tiles, background, options)
    d_image = device.upload(np.ones(blended.image.shape, np.float32))
    return count_pairs(device, blended, d_image)


def _of_updates(trainer: Trainer, frame: Frame) -> Iterator[Saving]:
    device = trainer.device
    scene = trainer.rounding.scene_at(trainer.state, trainer.steps_done)
    d_image = device.upload(np.ones(frame.image.shape, np.float32))
    gradients = rasterise_backward(device, scene, frame, d_image)
    marks = adam.mark_rows(device, gradients.d_feature, adam.stop_flag(device))
    moved = int(device.download(marks).sum())
    rows = trainer.parameters.count
    visible_only = trainer.config.adam == "visible"
    yield Saving("adam visible", "rows updated", moved if visible_only else rows, rows)


def _of_rate(config: TrainConfig) -> Saving:
    after = config.steps - config.switch_step
    due = config.steps // config.rate_interval - config.switch_step // config.rate_interval
    return Saving("rate interval", "steps with the rate proxy", due, after)


def _without(options: RenderOptions, skip: str) -> RenderOptions:
    return replace(options, skips=replace(options.skips, **{skip: False}))
