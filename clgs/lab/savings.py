"""How much work the skips save, counted on one view that a trainer looks at."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clgs.constants import K_OFFSETS, OUTPUT_DIM
from clgs.lab.kernels import PairCounts, count_pairs
from clgs.opencl.device import Device
from clgs.ops import adam, blend, mlp, tiles
from clgs.options import RenderOptions
from clgs.render.frame import Frame
from clgs.render.rasterise import rasterise_backward
from clgs.train.run.trainer import Trainer


@dataclass(frozen=True)
class Saving:
    """What is ``done`` of the work that would be done ``without`` a skip, both in ``unit``."""

    skip: str
    unit: str
    done: int
    without: int

    @property
    def share(self) -> float:
        """Share of the work that is left out."""
        return 1.0 - self.done / self.without if self.without else 0.0


def savings(trainer: Trainer) -> list[Saving]:
    """Count on the first training view, with the parameters as they are; renders it again."""
    device, config, frame = trainer.device, trainer.config, trainer.render_next()
    options, rows = frame.blended.options, trainer.parameters.count
    work = mlp_work(device, frame.activations)
    found = [
        Saving("anchors", "anchors decoded", work.all_samples, rows),
        Saving("opacity_first", "anchors with color", work.samples, work.all_samples),
        Saving("slots", "rows of color and shape", work.rows, work.all_rows),
    ]

    boxes = tiles.forward(
        device, frame.projected, frame.view.size, _without(options, "exact_tiles")
    )
    entries, more = (int(device.download(one.total)[0]) for one in (frame.tiles, boxes))
    found.append(Saving("exact_tiles", "tile entries", entries, more))
    filled = np.diff(device.download(frame.tiles.tile_range)) > 0
    found.append(Saving("empty_tiles", "tiles", int(filled.sum()), len(filled)))

    pairs = forward, _ = _pairs(device, frame, options)
    for skip, index in (("units", 0), ("finished", 0), ("contributors", 1)):
        plain = _pairs(device, frame, _without(options, skip))[index]
        unit = f"pairs visited, {('forward', 'backward')[index]}"
        found.append(Saving(skip, unit, pairs[index].visited, plain.visited))
    # blended pairs are what no skip can save
    found.append(Saving("(bound)", "pairs blended of visited", forward.blended, forward.visited))

    scene = trainer.rounding.scene_at(trainer.state, trainer.steps_done)
    d_image = device.upload(np.ones(frame.image.shape, np.float32))
    gradients = rasterise_backward(device, scene, frame, d_image)
    marks = adam.mark_rows(device, gradients.d_feature, adam.stop_flag(device))
    moved = int(device.download(marks).sum())
    updated = moved if config.adam == "visible" else rows
    found.append(Saving("adam visible", "rows updated", updated, rows))

    after = config.steps - config.switch_step
    due = config.steps // config.rate_interval - config.switch_step // config.rate_interval
    return [*found, Saving("rate interval", "steps with the rate proxy", due, after)]


def _pairs(device: Device, frame: Frame, options: RenderOptions) -> tuple[PairCounts, PairCounts]:
    background = frame.view.background
    blended = blend.forward(device, frame.projected, frame.tiles, background, options)
    d_image = device.upload(np.ones(blended.image.shape, np.float32))
    return count_pairs(device, blended, d_image)


def _without(options: RenderOptions, skip: str) -> RenderOptions:
    return replace(options, skips=replace(options.skips, **{skip: False}))


@dataclass(frozen=True)
class MlpWork:
    """Samples, and rows of outputs times samples, that were computed, and how many there are."""

    samples: int
    all_samples: int
    rows: int
    all_rows: int


def mlp_work(device: Device, activations: mlp.Activations) -> MlpWork:
    """Count the samples whose colors and covariances were computed, and the rows of these heads.

    Waits for the device. Columns without an anchor are not counted.
    """
    count = int(np.count_nonzero(device.download(activations.visible) >= 0))
    drawn = device.download(activations.output)[:K_OFFSETS] > 0
    macros = mlp.defines(device, activations.options)
    block = int(macros["VECTORS"] * macros["VEC"])
    size = int(macros["SAMPLES"]) if device.specialisation == "gpu" else block
    drawn = np.pad(drawn, ((0, 0), (0, -drawn.shape[1] % size)))
    slots = np.any(drawn.reshape(K_OFFSETS, -1, size), axis=2)
    used = np.any(slots, axis=0)
    skips = activations.options.skips
    if not skips.slots:
        slots[:] = used | (not skips.opacity_first)
    if not skips.opacity_first:
        used[:] = True
    lanes = np.clip(count - size * np.arange(len(used)), 0, size)
    each = (OUTPUT_DIM - K_OFFSETS) // K_OFFSETS
    return MlpWork(
        samples=int(used @ lanes),
        all_samples=count,
        rows=each * int((slots @ lanes).sum()),
        all_rows=each * K_OFFSETS * count,
    )
