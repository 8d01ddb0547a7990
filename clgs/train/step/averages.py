"""Parameters end with their mean over the last steps, not with what the last photo made of them.

Each step follows one photo, and Adam keeps moving at the pace of the learning rate: the mean lies
nearer to what all photos ask for (Polyak and Juditsky 1992). The steps that count are those since
the anchors and their integers were last chosen; in the steps after ``freeze_step`` only the MLPs
move, and they have a mean of their own.
"""

from __future__ import annotations

from dataclasses import replace

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import adam
from clgs.train.config import TrainConfig
from clgs.train.state.parameters import ANCHOR_GROUPS
from clgs.train.state.run_state import Means, RunState


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
