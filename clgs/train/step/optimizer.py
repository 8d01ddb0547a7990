"""Adam over all trained tensors with the method's learning-rate schedule, and means at the end.

Each step follows one photo, and Adam keeps moving at the pace of the learning rate: the mean of the
last steps lies nearer to what all photos ask for (Polyak and Juditsky 1992). The steps that count
are those since the anchors and their integers were last chosen; in the steps after ``freeze_step``
only the MLPs move, and they have a mean of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from clgs.constants import HEAD_DIMS
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import adam
from clgs.render.frame import SceneGradients
from clgs.scene.mlps import head_slice
from clgs.train.config import TrainConfig
from clgs.train.state.run_state import ANCHOR_GROUPS, Means, Parameters, RunState
from clgs.train.step import numpy_adam
from clgs.train.step.schedule import learning_rates


class Optimizer:
    """Updates parameters in place; leaves all of them untouched if a gradient is not finite."""

    def __init__(self, device: Device, config: TrainConfig, radius: float) -> None:
        """``radius`` in scene units scales the learning rate of offsets."""
        self._device, self._config, self._radius = device, config, radius
        self._adam = numpy_adam if config.optimizer == "numpy" else adam
        self._betas = adam.BETAS.of_batch(config.batch)
        self._box = config.learning_box
        self._inside: tuple[DeviceArray, DeviceArray] | None = None

    def step(
        self,
        parameters: Parameters,
        gradients: SceneGradients,
        losses: Sequence[DeviceArray],
        anchors_learn: bool,
        step: int,
        stop: DeviceArray,
        begun: int = 0,
    ) -> None:
        """Do Adam's step number ``step`` (from 1) on ``parameters``, in place.

        The moments were zero after step number ``begun``: Adam corrects for that.

        ``stop`` (1,) int32 is set if a gradient or one of ``losses``, float32 of any shape, is not
        finite; unless it holds 0 nothing changes. Without ``anchors_learn`` only the MLPs learn: in
        steps that replace the anchors, and if these rest. If only those in a box learn, the MLPs
        rest.
        """
        device = self._device
        rates = learning_rates(self._config, step, self._radius)
        names = (*ANCHOR_GROUPS, "weights") if anchors_learn else ("weights",)
        if self._box is not None:
            names = names[:-1]
        by_name = {name: getattr(gradients, f"d_{name}") for name in names}
        by_rows = [name for name in names if self._config.adam == "visible" and name != "weights"]
        whole = [array for name, array in by_name.items() if name not in by_rows]
        adam.check_finite(device, [*whole, *losses], stop)
        marks = {name: adam.mark_rows(device, by_name[name], stop) for name in by_rows}
        if self._box is not None:
            inside = self._rows_inside(parameters.scene.anchors.position)
            marks = dict.fromkeys(names, inside)
        tensors, updates = dict(parameters.scene.items()), []
        for name in names:
            trained = adam.Trained(tensors[name], by_name[name], parameters.moments[name])
            parts = [(slice(0, by_name[name].size), rates.get(name, 0.0))]
            if name == "weights":  # each MLP has its own learning rate
                parts = [(head_slice(head), rates[f"mlp_{head}"]) for head in HEAD_DIMS]
            for part, rate in parts:
                now = adam.factors(rate, step - begun, self._betas)
                if name in marks:
                    self._adam.step_rows(device, trained, now, stop, marks[name])
                else:
                    updates.append(adam.Update(trained, now, part))
        self._adam.step(device, updates, stop)

    def _rows_inside(self, position: DeviceArray) -> DeviceArray:
        """(A,) int32: 1 for the anchors that learn; positions stay until others replace them."""
        assert self._box is not None
        if self._inside is None or self._inside[0] is not position:
            inside = self._box.holds(self._device.download(position))
            self._inside = position, self._device.upload(inside.astype(np.int32))
        return self._inside[1]


def extend(
    device: Device, config: TrainConfig, state: RunState, step: int, stop: DeviceArray
) -> None:
    """Count the parameters after step number ``step``, unless it is too early.

    ``stop`` (1,) int32: unless it holds 0 nothing changes, and the step comes again.
    """
    begin = max(state.means.begin, config.switch_step, config.prune_end)
    if not config.average or step <= begin:
        return
    tensors, means = dict(state.parameters.scene.items()), state.means.tensors
    names = (*ANCHOR_GROUPS, "weights") if step <= config.freeze_step else ("weights",)
    for name in names:
        if name not in means:
            means[name] = device.zeros(tensors[name].shape)
        adam.average(device, means[name], tensors[name], step - begin, stop)


def take(state: RunState, step: int) -> None:
    """Give the parameters their means after step number ``step``, if there are any."""
    if found := state.means.tensors:
        scene = state.parameters.scene
        own = {name: found[name] for name in ANCHOR_GROUPS if name in found}
        scene = replace(scene, anchors=replace(scene.anchors, **own), weights=found["weights"])
        state.parameters = replace(state.parameters, scene=scene)
    state.means = Means(step)
