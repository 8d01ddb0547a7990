"""Run training steps of the synthetic scene: scene.py DEVICE GAUSSIANS WIDTH HEIGHT STEPS FILE.

DEVICE "default" is the usual one. A width of 0: no scene; that number of elements
is sorted and summed.

Writes to FILE, as JSON, every launch of the last step (kernel, stage, work-items, size of a
work-group, the first whole number among its arguments) and, of a device that is no emulator, how
much there was to do. A process of its own: it runs in the Python of the checkout that is counted,
an older one perhaps.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clgs.lab.bench.step import trainer_of
from clgs.lab.kernels import count_pairs
from clgs.lab.scenes import anchor_scene
from clgs.opencl.device import Device
from clgs.ops import scan, sort

SEED = 0


def main(arguments: Sequence[str]) -> None:
    """Run the steps and write."""
    name, steps, file = arguments[0], int(arguments[4]), Path(arguments[5])
    gaussians, width, height = map(int, arguments[1:4])
    device = Recorder(None if name == "default" else name, "gpu")
    if not width:
        file.write_text(json.dumps(sorted_elements(device, gaussians)), encoding="utf-8")
        return
    scene, camera = anchor_scene(gaussians, (width, height), SEED)
    trainer = trainer_of(device, scene, camera, SEED)
    for _ in range(steps):
        device.begin()
        result = trainer.step()
        device.finish()
    found = {"launches": list(device.launched), "loss": result.loss}
    if not device.is_emulator:
        found["units"] = units(device, trainer)
    file.write_text(json.dumps(found), encoding="utf-8")


def sorted_elements(device: Recorder, count: int) -> dict[str, Any]:
    """Sort ``count`` elements by one digit and by all, and make a prefix sum.

    The "loss" tells their order.
    """
    rng = np.random.default_rng(SEED)
    keys = device.upload(rng.integers(0, 2**8, count).astype(np.uint32))
    numbers = device.upload(np.arange(count, dtype=np.int32))
    device.begin()
    with device.stage("elements"):
        values = sort.by_key(device, keys, numbers, 8)[1]
        chosen = sort.chosen(device, keys, values).index
        offsets = scan.on_device(device, values).offset
    device.finish()
    launches = list(device.launched)
    weights = np.cos(np.arange(count + 1))
    order = float(device.download(values) @ weights[1:] + device.download(offsets) @ weights)
    order += float(device.download(chosen)[: count - 1] @ weights[: count - 1])
    return {"launches": launches, "loss": order, "units": {"elements": count}}


class Recorder(Device):
    """Keeps a list of what it launches, and in which stage."""

    launched: list[dict[str, Any]]
    _stage = "other"

    def begin(self) -> None:
        """Forget what was launched, here and in the counts of the plugin."""
        self.finish()
        self.launched = []
        if counts := os.environ.get("CLGS_GPU_COUNTS"):
            Path(counts).write_text("", encoding="utf-8")

    def run(
        self,
        kernel: Any,
        global_size: Sequence[int],
        local_size: Sequence[int] | None,
        /,
        **arguments: Any,
    ) -> None:
        """Run and record; work-groups that are left to the driver hold all items, up to 256."""
        if 0 in global_size:
            return
        group = tuple(local_size) if local_size else _group(global_size)
        values = [arguments[one.name] for one in kernel.parameters]
        if hasattr(self, "launched"):
            self.launched.append(
                {
                    "kernel": kernel.name,
                    "stage": self._stage,
                    "items": math.prod(map(int, global_size)),
                    "group": math.prod(map(int, group)),
                    "count": next((int(a) for a in values if isinstance(a, np.int32)), 0),
                }
            )
        super().run(kernel, global_size, group, **arguments)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Remember the stage."""
        before, self._stage = self._stage, name
        with super().stage(name):
            yield
        self._stage = before


def _group(global_size: Sequence[int]) -> tuple[int, ...]:
    room, group = 256, []
    for size in map(int, global_size):
        group.append(max(n for n in range(1, min(size, room) + 1) if size % n == 0))
        room //= group[-1]
    return tuple(group)


def units(device: Device, trainer: Any) -> dict[str, int]:
    """How much of everything a step has; pairs are those that the forward kernel looks at."""
    frame = trainer.render_next()
    held = frame.needed(device)
    forward, _ = count_pairs(device, frame.blended, device.zeros(frame.image.shape))
    tensors = [array for _, array in trainer.parameters.scene.items()]
    return {
        "anchors": trainer.parameters.count,
        "visible anchors": held.visible,
        "Gaussians": held.gaussians,
        "entries": held.entries,
        "pairs forward": forward.visited,
        "parameters": sum(int(array.size) for array in tensors),
    }


if __name__ == "__main__":
    main(sys.argv[1:])
