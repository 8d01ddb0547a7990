"""The settings of the three parts of a run in blocks: coarse scene, blocks, and all of it again.

The parts share the steps, the learning rates and the growth of one run. A block does as many of
the steps as it has of the cameras, so that each of its anchors is seen as often as in that run.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from clgs.data.reduction import LEAST_SIZE
from clgs.errors import UsageError
from clgs.train.config import TrainConfig
from clgs.train.config.option import options_of
from clgs.train.config.settings import FINE_Q

COARSE_SHARE = 0.25
"""Share of the steps that the coarse scene takes."""

COARSE_WIDTH = 400
"""Pixels: photos of the coarse scene are half as wide as others, but no narrower than this. From
narrower ones the MLPs learn too little for blocks, in which they rest.
"""

JOINT_SHARE = 0.8
"""The merged scene learns as a whole from this share of the steps before the switch to integers on,
so that it repairs between rounds what each of them leaves out.
"""

LEAST_STEPS = 10
"""Shorter runs have no room for three parts."""


def check_settings(config: TrainConfig) -> None:
    """Raise UsageError if a run of these settings cannot be cut in blocks."""
    if config.steps < LEAST_STEPS:
        raise UsageError(f"steps: {config.steps} are too few for --blocks; give {LEAST_STEPS}")
    if config.box:
        raise UsageError("--box: each block has a box of its own; leave out --box or --blocks")
    if config.exposure:
        raise UsageError("--exposure: a photo would have one in each block; leave out one of both")
    if config.batch > 1:
        raise UsageError("--batch: blocks are trained side by side; leave out --batch or --blocks")
    if config.adam == "visible":
        raise UsageError("--adam visible: blocks learn by adam = dense; leave it or --blocks out")


def coarse_config(config: TrainConfig, width: int) -> TrainConfig:
    """The settings of the coarse scene: photos at half their size if wide enough.

    ``config`` is resolved for the data set; ``width``: of its widest photo in pixels.
    """
    steps = round(COARSE_SHARE * config.steps)
    limits: dict[str, Any] = {"max_anchors": config.most_anchors, "target_size": 0}
    if config.downscale:
        times = 2 if width // 2 >= COARSE_WIDTH else 1
        return _unpriced(replace(config, **limits, downscale=times * config.downscale), steps)
    reduced = max(width // 2, min(width, COARSE_WIDTH), LEAST_SIZE)
    return _unpriced(replace(config, **limits, max_size=reduced), steps)


def block_config(config: TrainConfig, share: float, box: str) -> tuple[TrainConfig, int]:
    """The settings of a block, and the number of the last step that the coarse scene did for it.

    ``share``: of the cameras that the block has; ``box``: where anchors learn, as the setting says.
    """
    own = {
        name: max(one.least, round(share * getattr(config, name)))
        for name, one in options_of(TrainConfig).items()
        if one.scaled
    }
    own["growth_interval"] = max(1, round(share * config.growth_interval))
    begun = round(share * COARSE_SHARE * config.steps)
    steps = max(begun + 2, round(share * joint_begin(config)))
    own["steps"] = max(steps, round(share * config.steps))
    own["switch_step"] = own["freeze_step"] = own["steps"]
    grown = own["growth_end"] + own["growth_interval"]  # its statistics begin at zero
    own["growth_end"] = min(grown, own["steps"])
    priceless = replace(config, **own, target_size=0, max_anchors=0, box=box)
    return _unpriced(priceless, steps), begun


def joint_begin(config: TrainConfig) -> int:
    """The number of the last step before the merged scene is trained as a whole.

    It leaves steps to each of the three parts.
    """
    begin = round(JOINT_SHARE * config.switch_step)
    return min(max(begin, round(COARSE_SHARE * config.steps) + 2), config.steps - 2)


def joint_config(config: TrainConfig) -> TrainConfig:
    """The settings of the merged scene: from the last steps before the switch to integers on.

    No round before it thinned what grew, so that rounds go on until anchors rest.
    """
    begin = joint_begin(config)
    names = ("switch_step", "freeze_step", "mlp_switch_step")
    later = {name: max(begin, getattr(config, name)) for name in names}
    later["prune_end"] = later["freeze_step"]
    later["switch_step"] = min(later["switch_step"], config.steps - 1)
    growth = {
        name: min(getattr(config, name), begin)
        for name in ("statistics_start", "growth_start", "growth_end")
    }
    return replace(config, coarse_to_fine=False, **growth, **later)


def _unpriced(config: TrainConfig, steps: int) -> TrainConfig:
    """The first ``steps`` of a run, in which nothing is priced.

    Only the last of them is at integers, fine ones, for which positions move to their grid.
    """
    growth = {
        name: min(getattr(config, name), steps - 1)
        for name in ("statistics_start", "growth_start", "growth_end")
    }
    return replace(
        config,
        **growth,
        **{name: getattr(config, name) or q for name, q in FINE_Q.items()},
        steps=steps,
        switch_step=steps - 1,
        prune_end=steps,
        freeze_step=steps,
        mlp_switch_step=steps,
        mlp="float32",
        size_lambda=0.0,
        rate_weight=0.0,
        coarse_to_fine=False,
    )
