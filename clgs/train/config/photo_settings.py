"""The settings that say how photos are seen: part of the settings of training."""

from __future__ import annotations

from dataclasses import dataclass

from clgs.data.reduction import LEAST_SIZE, MAX_SIZE
from clgs.train.config.option import WEIGHT, Range, at_least, option


@dataclass(frozen=True)
class PhotoSettings:
    """Size, memory and exposure of photos; part of :class:`TrainConfig`."""

    downscale: int = option(
        0,
        "reduce the photos this many times, whatever --max-size says; 0: as that says",
        at_least(0),
        unit="times",
        group="photos",
    )
    max_size: int = option(
        MAX_SIZE,
        "reduce photos that are wider to this width (3DGS); 0: never",
        Range(LEAST_SIZE, or_zero=True),
        unit="pixels",
    )
    photo_memory: int = option(
        1024,
        "training photos that stay in memory, 3 bytes a pixel; those beyond it are read again from "
        "the disk, ahead of their steps",
        at_least(0),
        unit="MiB",
        in_digest=False,
    )
    exposure: bool = option(
        False,
        "learn the exposure of each training photo, an affine map of colors, from a fifth of the "
        "steps on; the scene and the held-out views are without",
    )
    exposure_weight: float = option(
        0.1,
        "weight of the squared distance of a photo's map from none, with --exposure",
        WEIGHT,
        unit="none",
    )
