"""Adam over all trained tensors with the method's learning-rate schedule."""

from __future__ import annotations

from dataclasses import dataclass

from clgs.constants import HEAD_DIMS
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import adam
from clgs.render.frame import SceneGradients
from clgs.scene.mlps import head_slice
from clgs.train.config import TrainConfig
from clgs.train.state.parameters import ANCHOR_GROUPS, Parameters
from clgs.train.step import numpy_adam
from clgs.train.step.schedule import learning_rates


@dataclass(frozen=True)
class Learned:
    """What a step learned.

    anchors: False on steps that replace the anchors, and if these rest: only the MLPs learn then.
    loss: float32 of any shape, finite if the loss is.
    """

    gradients: SceneGradients
    anchors: bool
    loss: DeviceArray


class Optimizer:
    """Updates parameters in place; leaves all of them untouched if a gradient is not finite."""

    def __init__(self, device: Device, config: TrainConfig, radius: float) -> None:
        """``radius`` in scene units scales the learning rate of offsets."""
        self._device, self._config, self._radius = device, config, radius
        self._adam = numpy_adam if config.optimizer == "numpy" else adam

    def step(self, parameters: Parameters, learned: Learned, step: int, stop: DeviceArray) -> None:
        """One Adam step number ``step`` (from 1).

        ``stop`` (1,) int32 is set if a gradient or the loss is not finite; unless it holds 0
        nothing changes.
        """
        rates = learning_rates(self._config, step, self._radius)
        names = (*ANCHOR_GROUPS, "weights") if learned.anchors else ("weights",)
        by_name = {name: getattr(learned.gradients, f"d_{name}") for name in names}
        tensors = dict(parameters.scene.items())
        marks = self._check(by_name, learned.loss, stop)
        updates = []
        for name in names:
            trained = adam.Trained(tensors[name], by_name[name], parameters.moments[name])
            for part, rate in _parts(name, by_name[name].size, rates):
                now = adam.factors(rate, step)
                if name in marks:
                    self._adam.step_rows(self._device, trained, now, stop, marks[name])
                else:
                    updates.append(adam.Update(trained, now, part))
        self._adam.step_all(self._device, updates, stop)

    def _check(
        self, gradients: dict[str, DeviceArray], loss: DeviceArray, stop: DeviceArray
    ) -> dict[str, DeviceArray]:
        """Set ``stop`` if needed; the rows to update of those groups that are updated by rows."""
        by_rows = [
            name for name in gradients if self._config.adam == "visible" and name != "weights"
        ]
        whole = [array for name, array in gradients.items() if name not in by_rows]
        adam.check_finite(self._device, [*whole, loss], stop)
        return {name: adam.mark_rows(self._device, gradients[name], stop) for name in by_rows}


def _parts(name: str, size: int, rates: dict[str, float]) -> list[tuple[slice, float]]:
    """Elements of a tensor with one learning rate, and that rate; the MLPs have one per head."""
    if name == "weights":
        return [(head_slice(head), rates[f"mlp_{head}"]) for head in HEAD_DIMS]
    return [(slice(0, size), rates[name])]
