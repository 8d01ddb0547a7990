"""The part of the loss that counts bytes: the rate proxy's gradient, added at every step.

What the proxy knows of all anchors, a table per attribute, is made every ``rate_interval`` steps
and kept in between; the gradient of an integer follows from its own value and the kept table.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
import numpy.typing as npt

from clgs.opencl.device import Device
from clgs.ops import rate
from clgs.render.frame import SceneGradients
from clgs.scene.anchors import QuantizationScales, rounded
from clgs.train.config import TrainConfig
from clgs.train.rate.entropy import coded_bits
from clgs.train.state.parameters import ANCHOR_GROUPS, Parameters

PUSH = 4.0
"""Times its price that a bit counts in the gradient: Adam takes small steps towards few bits."""

KEPT = 2
"""Tables kept: a step that is done again may need those of before its successors began."""


@dataclass(frozen=True, eq=False)
class Tables:
    """Of step ``step``: the rate of each of ANCHOR_GROUPS, and the number of anchors."""

    step: int
    rates: dict[str, rate.Rate]
    anchors: int

    @property
    def bits(self) -> float:
        """Per anchor."""
        return sum(one.bits for one in self.rates.values())


class RateTerm:
    """Adds the gradient of the price of the file, whose bits the proxy estimates."""

    def __init__(self, device: Device, config: TrainConfig, scales: QuantizationScales) -> None:
        """``scales``: the integers per unit that attributes are rounded to.

        The ``price`` of a bit, in units of the loss, is 0 until someone sets it.
        """
        self._device, self._config = device, config
        self.scales, self.price = scales, 0.0
        self._kept: list[Tables] = []
        self._slopes: tuple[Tables, float, dict[str, rate.Slopes]] | None = None

    def add(self, parameters: Parameters, gradients: SceneGradients, step: int) -> float | None:
        """Add the gradient in place if it is due; returns bits per anchor if they were counted."""
        config = self._config
        within = config.switch_step < step <= config.freeze_step
        if not within or not (self.price or config.rate_weight):
            return None
        due = step % config.rate_interval == 0
        with self._device.stage("rate"):
            tables = self._tables(parameters, step)
            weight = PUSH * self.price * tables.anchors
            if due:
                weight += config.rate_weight
            if weight:
                arrays = [
                    (
                        one,
                        getattr(parameters.scene.anchors, name),
                        getattr(gradients, f"d_{name}"),
                    )
                    for name, one in self._slopes_of(tables, weight).items()
                ]
                rate.backward_all(self._device, arrays)
        return tables.bits if due else None

    def _slopes_of(self, tables: Tables, weight: float) -> dict[str, rate.Slopes]:
        """Those of every attribute, made when the tables or their weight change."""
        if self._slopes is None or self._slopes[:2] != (tables, weight):
            made = {
                name: rate.slopes(self._device, one, weight) for name, one in tables.rates.items()
            }
            self._slopes = tables, weight, made
        return self._slopes[2]

    def measure(self, parameters: Parameters, step: int) -> Tables:
        """The rates of the anchors as they are."""
        form: rate.Form = "pooled" if self._config.proxy == "pooled" else "channel"
        rates = {
            name: rate.forward(
                self._device,
                getattr(parameters.scene.anchors, name),
                getattr(self.scales, name),
                form,
            )
            for name in ANCHOR_GROUPS
        }
        return Tables(step, rates, parameters.count)

    def estimated_bits(self, parameters: Parameters) -> float:
        """Bits per anchor of the rounded attributes, about as the file will have them."""
        anchors = parameters.download_anchors(self._device)
        integers = {
            name: rounded(getattr(anchors, name), getattr(self.scales, name))
            for name in ANCHOR_GROUPS
        }
        return sum(coded_bits(integers).values()) / parameters.count

    def _tables(self, parameters: Parameters, step: int) -> Tables:
        """Those for step number ``step``: made new if they are due, else the newest before it."""
        self._kept = [one for one in self._kept if one.step < step]
        if not self._kept or step % self._config.rate_interval == 0:
            self._kept.append(self.measure(parameters, step))
        self._kept = self._kept[-KEPT:]
        return self._kept[-1]

    def state(self) -> dict[str, npt.NDArray[np.float64]]:
        """All that :meth:`restore` needs to continue exactly, by name."""
        found = {"rate.scales": np.array(astuple(self.scales)), "rate.price": np.array(self.price)}
        if self._kept:
            newest = self._kept[-1]
            found |= {f"rate.{name}": one.table for name, one in newest.rates.items()}
            bits = (one.bits for one in newest.rates.values())
            found["rate.kept"] = np.array([newest.step, newest.anchors, *bits], np.float64)
        return found

    def restore(self, arrays: dict[str, npt.NDArray[np.float64]]) -> None:
        """Take what :meth:`state` gave; other arrays are ignored."""
        self.scales = QuantizationScales(*map(float, arrays["rate.scales"]))
        self.price = float(arrays["rate.price"])
        self._kept = []
        if "rate.kept" in arrays:
            step, anchors, *bits = arrays["rate.kept"]
            rates = {
                name: rate.Rate(float(each), getattr(self.scales, name), arrays[f"rate.{name}"])
                for name, each in zip(ANCHOR_GROUPS, bits, strict=True)
            }
            self._kept = [Tables(int(step), rates, int(anchors))]
