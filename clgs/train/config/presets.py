"""Named configurations, and settings in layers over them: a file's, then those of a command."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from clgs.train.config.learning_rates import LearningRates
from clgs.train.config.settings import PAPER_Q, TrainConfig

PAPER_RATES = LearningRates(feature=(0.0075, 0.0075), scaling=(0.007, 0.007))

Values = Mapping[str, Any]
"""Checked values by name; those of tables are dotted."""


def preset(name: str) -> TrainConfig:
    """A named configuration.

    "default": 30,000 steps. "quick": the same at 3,000 steps, see :meth:`TrainConfig.scaled`.
    "paper": the data's own units, Q_P as published and the pooled rate proxy, so that published
    numbers can be compared; its loss weights are the code's 0.8 / 0.2, which made those numbers
    (the paper's text says 0.2 / 0.8).

    Raises:
        UsageError: no such preset.
    """
    config = TrainConfig(preset=name)
    if name == "quick":
        return config.scaled(3_000)
    if name == "paper":
        return replace(
            config,
            normalize=False,
            proxy="pooled",
            size_lambda=0.0,
            rate_weight=1e-4,
            freeze_step=config.steps,
            **PAPER_Q,
            mlp="float32",
            learning_rates=PAPER_RATES,
            start_points=100_000,
            start_volume="cube",
            start_pixels=0.0,
            start_mlps="random",
        )
    return config


def layered(*layers: Values) -> TrainConfig:
    """The preset that the last layer with one names, with each layer over those before it.

    ``steps`` in a layer scales what lies below, as :meth:`TrainConfig.scaled`; the other values of
    that layer are taken as they are.

    Raises:
        UsageError: values that do not go together.
    """
    names = [layer["preset"] for layer in layers if "preset" in layer]
    config = preset(names[-1] if names else "default")
    waiting: dict[str, Any] = {}
    for layer in layers:
        if "steps" in layer:
            config = _with(config, waiting).scaled(layer["steps"])
            waiting = {}
        waiting |= {name: layer[name] for name in layer if name not in ("preset", "steps")}
    return _with(config, waiting)


def _with(config: TrainConfig, values: Values) -> TrainConfig:
    """``config`` with ``values``, of which dotted ones belong to a table."""
    plain = {name: value for name, value in values.items() if "." not in name}
    for table in {name.split(".")[0] for name in values} - set(plain):
        inner = {name.split(".")[1]: values[name] for name in values if f"{table}." in name}
        plain[table] = replace(getattr(config, table), **inner)
    return replace(config, **plain)
