"""The learning rate of each group of parameters, at the first step and at the last."""

from __future__ import annotations

from dataclasses import dataclass, replace

from clgs.errors import UsageError
from clgs.train.config.option import POSITIVE, Pair, option, options_of

SHORT_RUN_POWERS = {"feature": (0.5, 0.5), "offset": (0.25, 0.25), "exposure": (0.5, 0.5)}
"""A run n times shorter multiplies the first and the last of these learning rates by n to these
powers.
"""


@dataclass(frozen=True)
class LearningRates:
    """(first, last) of each group, log-linear in between; equal ends stay constant.

    Positions of anchors are not trained, so there is no group for them.
    """

    offset: Pair = option(
        (0.01, 0.0001),
        "first and last learning rate of offsets, multiplied by the scene radius",
        POSITIVE,
        unit="per step",
        group="learning rates",
    )
    feature: Pair = option(
        (0.0075, 0.00075),
        "first and last learning rate of features (code: constant, which preset paper takes)",
        POSITIVE,
        unit="per step",
    )
    scaling: Pair = option(
        (0.007, 0.0007),
        "first and last learning rate of scalings (code: 0.007, which preset paper takes)",
        POSITIVE,
        unit="per step",
    )
    mlp_opacity: Pair = option(
        (0.002, 2e-5), "first and last learning rate of the opacity MLP", POSITIVE, unit="per step"
    )
    mlp_covariance: Pair = option(
        (0.004, 0.004),
        "first and last learning rate of the covariance MLP",
        POSITIVE,
        unit="per step",
    )
    mlp_color: Pair = option(
        (0.008, 5e-5), "first and last learning rate of the color MLP", POSITIVE, unit="per step"
    )
    exposure: Pair = option(
        (0.01, 0.001),
        "first and last learning rate of the exposure of photos (3DGS)",
        POSITIVE,
        unit="per step",
    )

    def __post_init__(self) -> None:
        for name, one in options_of(LearningRates).items():
            try:
                object.__setattr__(self, name, one.check(getattr(self, name)))
            except UsageError as error:
                raise UsageError(f"learning_rates.{error}") from None

    def for_shorter_run(self, shorter: float) -> LearningRates:
        """The rates of a run that is ``shorter`` times as short, as SHORT_RUN_POWERS says.

        Features and offsets start at zero, and a short run would leave them small compared
        with the steps of rounding when that begins. The exposure of a photo moves only when that
        photo is seen.
        """
        changed = {
            name: tuple(
                rate * shorter**power
                for rate, power in zip(getattr(self, name), powers, strict=True)
            )
            for name, powers in SHORT_RUN_POWERS.items()
        }
        return replace(self, **changed)
