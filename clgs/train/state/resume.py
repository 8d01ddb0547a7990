"""Save and restore the state of a run, so that a resumed run gives the same bits."""

from __future__ import annotations

import tomllib
from dataclasses import astuple, fields
from pathlib import Path

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops.adam import Moments
from clgs.ops.density import Statistics
from clgs.ops.rate import Rate
from clgs.render.frame import DeviceScene
from clgs.scene.anchors import FIELDS, Anchors, QuantizationScales
from clgs.train.config import TrainConfig
from clgs.train.config.option import options_of
from clgs.train.quality.importance import Sensitivity
from clgs.train.state import checkpoint
from clgs.train.state.checkpoint import Arrays
from clgs.train.state.parameters import ANCHOR_GROUPS, Parameters
from clgs.train.state.run_state import (
    ExposureMaps,
    Means,
    RateState,
    RateTables,
    RunState,
    ViewOrder,
)

SETTINGS = "config.toml"
"""The first file of a run."""

SHOWN = 3
"""The most settings that a message names."""


def save_state(folder: Path, device: Device, state: RunState, digest: str) -> None:
    """Write a checkpoint of ``state``; no anchor may be hidden.

    Raises:
        ClgsError: as :func:`clgs.train.state.checkpoint.save`.
    """
    parameters = state.parameters
    assert not parameters.hidden
    arrays: dict[str, DeviceArray] = dict(parameters.scene.items())
    for name, moments in parameters.moments.items():
        arrays |= {f"{which}.{name}": array for which, array in moments.items()}
    arrays |= {f"statistics.{name}": array for name, array in parameters.statistics.items()}
    if state.exposures is not None:
        arrays["exposure"] = state.exposures.maps
        moments = state.exposures.moments
        arrays |= {f"{which}.exposure": array for which, array in moments.items()}
    arrays |= {f"mean.{name}": array for name, array in state.means.tensors.items()}
    scalars = {
        "step": state.step,
        "mean_begin": state.means.begin,
        "merged": state.merged,
        "begun": state.begun,
        "rng": state.rng.bit_generator.state,
        "sampler": state.views.record(),
    }
    host: Arrays = {name: device.download(array) for name, array in arrays.items()}
    rate, known = state.rate, state.known
    host["rate.scales"], host["rate.price"] = np.array(astuple(rate.scales)), np.array(rate.price)
    if rate.tables:
        newest = rate.tables[-1]
        host |= {f"rate.{name}": one.table for name, one in newest.rates.items()}
        bits = (one.bits for one in newest.rates.values())
        host["rate.kept"] = np.array([newest.step, newest.anchors, *bits], np.float64)
    if known is not None:
        host |= {"known.importance": known.importance, "known.seen": known.seen}
        host |= {f"known.{name}": array for name, array in known.curvature.items()}
    checkpoint.save(folder, host, scalars, digest)


def load_state(folder: Path, device: Device, digest: str, changed: str = "") -> RunState:
    """The state in the newest usable checkpoint, on ``device``.

    ``digest`` and ``changed`` as for :func:`clgs.train.state.checkpoint.load`.

    Raises:
        DataError: all checkpoints are damaged, or belong to a run with other settings or photos.
    """
    host, scalars = checkpoint.load(folder, digest, changed)
    on_host = ("rate.", "known.")
    arrays = {n: device.upload(array) for n, array in host.items() if not n.startswith(on_host)}
    moments = {
        name.removeprefix("first."): Moments(array, arrays[name.replace("first.", "second.")])
        for name, array in arrays.items()
        if name.startswith("first.")
    }
    means = {n.removeprefix("mean."): a for n, a in arrays.items() if n.startswith("mean.")}
    exposures = None
    if "exposure" in arrays:
        exposures = ExposureMaps(arrays["exposure"], moments.pop("exposure"))
    scene = DeviceScene(Anchors(*(arrays[name] for name in FIELDS)), arrays["weights"])
    statistics = Statistics(*(arrays[f"statistics.{one.name}"] for one in fields(Statistics)))
    scales = QuantizationScales(*map(float, host["rate.scales"]))
    rate = RateState(scales, float(host["rate.price"]))
    if "rate.kept" in host:
        step, anchors, *bits = host["rate.kept"]
        rates = {
            name: Rate(float(each), getattr(scales, name), host[f"rate.{name}"])
            for name, each in zip(ANCHOR_GROUPS, bits, strict=True)
        }
        rate.tables = [RateTables(int(step), rates, int(anchors))]
    known = None
    if "known.seen" in host:
        curvature = {name: host[f"known.{name}"] for name in ANCHOR_GROUPS}
        known = Sensitivity(host["known.importance"], curvature, host["known.seen"])
    rng = np.random.default_rng()
    rng.bit_generator.state = scalars["rng"]
    return RunState(
        parameters=Parameters(scene, moments, statistics),
        rate=rate,
        exposures=exposures,
        rng=rng,
        views=ViewOrder.restore(scalars["sampler"]),
        known=known,
        means=Means(int(scalars.get("mean_begin", 0)), means),
        merged=int(scalars["merged"]),
        step=int(scalars["step"]),
        begun=int(scalars.get("begun", 0)),
    )


def changed_settings(folder: Path, config: TrainConfig) -> str:
    """What differs between ``config`` and the run in ``folder``: " (--steps: 300 there, 400 here)".

    The text is empty if that is unknown, or if no setting that results depend on differs.
    """
    try:
        there = tomllib.loads((folder / SETTINGS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return ""
    here = tomllib.loads(config.to_toml())
    options = options_of(TrainConfig)
    kept = [name for name, one in options.items() if one.in_digest]
    names = [name for name in kept if there.get(name) != here.get(name)]
    if "steps" in names:
        names = ["steps"]  # most others follow from it
    elif "batch" in names:
        names = [name for name in names if name != "size_lambda"]  # follows from it
    shown = [
        f"{options[name].flag}: {there.get(name)} there, {here.get(name)} here"
        for name in names[:SHOWN]
    ]
    return f" ({'; '.join(shown)})" if shown else ""
