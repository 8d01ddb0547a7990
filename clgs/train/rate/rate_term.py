"""The gradient of the price of the file, added from the switch step on until anchors rest.

The proxy knows the anchors by a table per attribute, which is made every ``rate_interval`` steps
and kept in between. The gradient of an integer follows from its own value and the kept table.
"""

from __future__ import annotations

from clgs.codec.fit_size import POSITION_BITS
from clgs.opencl.device import Device
from clgs.ops import rate
from clgs.render.frame import SceneGradients
from clgs.scene.anchors import QuantizationScales, rounded
from clgs.train.config import TrainConfig
from clgs.train.config.size_settings import MLP_BYTES
from clgs.train.rate.entropy import coded_bits
from clgs.train.state.parameters import ANCHOR_GROUPS, Parameters
from clgs.train.state.run_state import RateState, RateTables

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
    anchors = parameters.download_anchors(device)
    integers = {
        name: rounded(getattr(anchors, name), getattr(scales, name)) for name in ANCHOR_GROUPS
    }
    bits = sum(coded_bits(integers).values()) / parameters.count + POSITION_BITS
    return int(parameters.count * bits / 8) + MLP_BYTES[config.mlp]
