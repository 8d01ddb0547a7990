"""The gradient of the price of the file, added from the switch step on until anchors rest.

The proxy knows the anchors by a table per attribute, which is made every ``rate_interval`` steps
and kept in between. The gradient of an integer follows from its own value and the kept table.

The bits of integers, if each channel is coded by its own frequencies, take milliseconds to
estimate. The frequencies are those of all anchors, or of anchors that are about as active.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from clgs.codec.smaller import POSITION_BITS
from clgs.opencl.device import Device
from clgs.ops import rate
from clgs.render.frame import SceneGradients
from clgs.scene.anchors import QuantizationScales, rounded
from clgs.train.config import TrainConfig
from clgs.train.config.size_settings import MLP_BYTES
from clgs.train.state.run_state import ANCHOR_GROUPS, Parameters, RateState, RateTables

MOST_VALUES = 2**16
"""Values are counted in a table if they span fewer integers; else they are sorted: slower."""


CLASSES = 16
"""Classes of anchors by the size of their integers: about what the encoder's contexts know."""


def coded_bits(integers: Mapping[str, npt.NDArray[np.integer]]) -> dict[str, float]:
    """Estimate the bits in the file of ``offset``, ``feature`` and ``scaling`` (A, ...) each.

    Features and scalings are counted among anchors whose features are about as large, offsets among
    anchors whose offsets are; or without classes, if that takes less.
    """
    active = {name: activity_classes(integers[name]) for name in ("feature", "offset")}
    classes = {**active, "scaling": active["feature"]}
    return {
        name: min(entropy_bits(rows), class_bits(rows, classes[name]))
        for name, rows in integers.items()
    }


def activity_classes(integers: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """The class (A,) of each anchor, 0 to CLASSES - 1, with about equally many anchors in each."""
    if not len(integers):
        return np.zeros(0, np.int64)
    size = np.abs(integers.reshape(len(integers), -1)).mean(axis=1, dtype=np.float64)
    limits = np.quantile(size, np.arange(1, CLASSES) / CLASSES)
    return np.asarray(np.searchsorted(limits, size), np.int64)


def class_bits(integers: npt.NDArray[np.integer], classes: npt.NDArray[np.int64]) -> float:
    """Bits of all of the integers (A, ...), each channel by its frequencies in each class (A,).

    Learning a frequency costs half the logarithm of how many integers it was learned from
    (Schwarz 1978). A channel of too wide a range counts without classes.
    """
    bits = 0.0
    for column in integers.reshape(len(integers), -1).T:
        channel = np.ascontiguousarray(column)
        first, most = (int(channel.min()), int(channel.max())) if len(channel) else (0, 0)
        width = most - first + 1
        if width * CLASSES > MOST_VALUES:
            bits += entropy_bits(channel[:, None])
            continue
        places = classes * width + (channel.astype(np.int64) - first)
        counts = np.bincount(places, minlength=CLASSES * width).reshape(CLASSES, width)
        total, learned = counts.sum(axis=1), np.count_nonzero(counts, axis=1) - 1
        bits += float((total * _log2(total)).sum() - (counts * _log2(counts)).sum())
        bits += 0.5 * float((np.maximum(learned, 0) * _log2(total)).sum())
    return bits


def _log2(counts: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Logarithms of counts, 0 for none."""
    return np.asarray(np.log2(np.maximum(counts, 1)))


def entropy_bits(integers: npt.NDArray[np.integer]) -> float:
    """Bits of all of the integers (A, ...), every index after the first being a channel.

    The zeroth-order entropy of each channel, summed: what an ideal coder takes that knows the
    channel's histogram and no context. The rate proxy's Laplace law says more if many are 0.
    """
    bits = 0.0
    channels = math.prod(integers.shape[1:])
    for column in integers.reshape(len(integers), channels).T:
        if not len(column):
            continue
        channel = np.ascontiguousarray(column)
        first = int(channel.min())
        if int(channel.max()) - first > MOST_VALUES:
            counts = np.unique(channel, return_counts=True)[1]
        else:
            counts = np.bincount(channel.astype(np.int64) - first)
            counts = counts[counts > 0]
        bits += float((counts * np.log2(len(channel) / counts)).sum())
    return bits


PUSH = 4.0
"""The gradient of the price is multiplied by this: Adam's steps towards fewer bits would be small.
"""

KEPT = 2
"""Tables kept: a repeated step may need an older table than the newest."""


class RateTerm:
    """Adds the gradient of the price of the file, whose bits the proxy estimates."""

    def __init__(self, device: Device, config: TrainConfig) -> None:
        """Price the parameters of one run."""
        self._device, self._config = device, config
        self._slopes: tuple[RateTables, float, dict[str, rate.Slopes]] | None = None

    def add(
        self, state: RateState, parameters: Parameters, gradients: SceneGradients, step: int
    ) -> float | None:
        """Add the gradient in place if it is due; return bits per anchor if they were counted."""
        config = self._config
        within = config.switch_step < step <= config.freeze_step
        if not within or not (state.price or config.rate_weight):
            return None
        due = step % config.rate_interval == 0
        with self._device.stage("rate"):
            state.tables = [one for one in state.tables if one.step < step]
            if not state.tables or due:
                state.tables.append(self.measure(state.scales, parameters, step))
            state.tables = state.tables[-KEPT:]
            tables = state.tables[-1]
            weight = PUSH * state.price * tables.anchors
            if due:
                weight += config.rate_weight
            if weight:
                if self._slopes is None or self._slopes[:2] != (tables, weight):
                    made = {
                        n: rate.slopes(self._device, r, weight) for n, r in tables.rates.items()
                    }
                    self._slopes = tables, weight, made
                arrays = [
                    (one, getattr(parameters.scene.anchors, name), getattr(gradients, f"d_{name}"))
                    for name, one in self._slopes[2].items()
                ]
                rate.backward(self._device, arrays)
        return tables.bits if due else None

    def measure(self, scales: QuantizationScales, parameters: Parameters, step: int) -> RateTables:
        """Make the tables of the anchors as they are."""
        form: rate.Form = "pooled" if self._config.proxy == "pooled" else "channel"
        anchors = parameters.scene.anchors
        rates = {
            name: rate.forward(self._device, getattr(anchors, name), getattr(scales, name), form)
            for name in ANCHOR_GROUPS
        }
        return RateTables(step, rates, parameters.count)


def estimated_bytes(
    device: Device, config: TrainConfig, parameters: Parameters, scales: QuantizationScales
) -> int:
    """About the bytes that the file of the rounded parameters has."""
    anchors, integers = parameters.scene.anchors, {}
    shown = ~np.isnan(device.download(anchors.position)[:, 0])
    for name in ANCHOR_GROUPS:  # one array of floats at a time: a run peaks here
        values = device.download(getattr(anchors, name))[shown]
        integers[name] = rounded(values, getattr(scales, name))
    bits = sum(coded_bits(integers).values()) / parameters.count + POSITION_BITS
    return int(parameters.count * bits / 8) + MLP_BYTES[config.mlp]
