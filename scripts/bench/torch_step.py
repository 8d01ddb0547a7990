"""A step of ``clgs.torch``, forward and backward, compared with the OpenCL stages alone, in turn.

    python scripts/bench/torch_step.py [GAUSSIANS WIDTH HEIGHT RUNS]

Shortest and median milliseconds on the wall, the shortest processor time of the calling thread,
which other work on the machine disturbs less, and the arrays and bytes copied to and from the
device in a step.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
import torch

import clgs.torch as ours
from clgs.ops.general import views
from clgs.options import DEFAULT
from clgs.render import channel_picture
from clgs.render.rasterization import default_device

Step = Callable[[], None]


def scene(count: int, width: int, height: int) -> list[np.ndarray]:
    """Gaussians in a box in front of a camera, smaller if they are more, and its matrices."""
    rng = np.random.default_rng(0)
    viewmat, focal = np.eye(4), float(width)
    viewmat[2, 3] = 4
    arrays = [
        rng.uniform(-1.5, 1.5, (count, 3)),
        rng.normal(size=(count, 4)),
        0.02 * (100_000 / count) ** (1 / 3) * 10 ** rng.uniform(-0.4, 0.4, (count, 3)),
        rng.uniform(0.05, 0.95, count),
        rng.uniform(0, 1, (count, 3)),
        viewmat[None],
        np.array([[[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]]),
    ]
    return [array.astype(np.float32) for array in arrays]


def stages(arrays: list[np.ndarray], width: int, height: int) -> Step:
    """The stages that a step runs, on arrays that are on the device."""
    device = default_device()
    mean, rotation, scale, opacity, color = (device.upload(one) for one in arrays[:5])
    splats, lens, size = (
        views.Splats(mean, scale, rotation, opacity),
        views.CameraModel(),
        (width, height),
    )
    camera = device.upload(views.pack_camera(arrays[5][0], arrays[6][0], size, lens.near))
    shade, d_left = device.zeros((3,)), device.zeros((height, width))
    d_image = device.upload(np.ones((height, width, 3), np.float32))

    def step() -> None:
        projected = views.forward(device, splats, camera, lens, color, DEFAULT)
        drawn = channel_picture.draw(device, projected, size, shade, False, 0.999, DEFAULT)
        d = channel_picture.backward(device, drawn, d_image, d_left)
        views.backward(device, splats, camera, lens, projected, d)
        device.finish()

    return step


def autograd(arrays: list[np.ndarray], width: int, height: int, packed: bool) -> Step:
    """The same through PyTorch."""
    tensors = [torch.tensor(one) for one in arrays]
    for tensor in tensors[:5]:
        tensor.requires_grad_()
    d_image = torch.ones(1, height, width, 3)

    def step() -> None:
        for tensor in tensors[:5]:
            tensor.grad = None
        ours.rasterization(*tensors, width, height, packed=packed)[0].backward(d_image)

    return step


def copies(step: Step) -> str:
    """What a step copies between host and device, without cameras and other arrays below 1 kB."""
    device, sizes = default_device(), []
    usual = device._transfers.write, device._transfers.read

    def write(buffer: object, host: np.ndarray) -> None:
        sizes.append(host.nbytes)
        usual[0](buffer, host)

    def read(array: object) -> object:
        sizes.append(array.nbytes)
        return usual[1](array)

    device._transfers.write, device._transfers.read = write, read
    step()
    device._transfers.write, device._transfers.read = usual
    large = [size for size in sizes if size >= 1024]
    return f"{len(large)} arrays, {sum(large)} bytes copied"


def timed(step: Step) -> tuple[float, float]:
    """Milliseconds on the wall, and of the calling thread."""
    wall, thread = time.perf_counter(), time.thread_time()
    step()
    return 1e3 * (time.perf_counter() - wall), 1e3 * (time.thread_time() - thread)


def main(count: int = 100_000, width: int = 400, height: int = 400, runs: int = 15) -> None:
    """Print a line for each form."""
    arrays = scene(count, width, height)
    alone = stages(arrays, width, height)
    for packed in (True, False):
        through = autograd(arrays, width, height, packed)
        alone(), through()
        times = np.array([(*timed(alone), *timed(through)) for _ in range(runs)])
        low, middle = times.min(axis=0), np.median(times, axis=0)
        print(
            f"packed {packed}: stages {low[0]:.1f} ({middle[0]:.1f}), thread {low[1]:.1f}; "
            f"PyTorch {low[2]:.1f} ({middle[2]:.1f}), thread {low[3]:.1f}; "
            f"ratio {low[2] / low[0]:.2f} ({middle[2] / middle[0]:.2f}); {copies(through)}",
            flush=True,
        )


if __name__ == "__main__":
    main(*(int(one) for one in sys.argv[1:]))
