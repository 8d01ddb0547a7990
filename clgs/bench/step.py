"""Time one training step on a seeded synthetic scene, stage by stage."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import product
from statistics import median

import numpy as np

from clgs.bench.frame_counts import count_frame
from clgs.opencl.device import Device
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import Scene
from clgs.synthetic.anchor_scene import anchor_scene, photo_dataset
from clgs.train.config import LearningRates, TrainConfig
from clgs.train.density.densifier import Densifier
from clgs.train.run.trainer import Trainer
from clgs.train.state.parameters import new_parameters

WARM_UP = 3
STILL = LearningRates(*[(1e-12, 1e-12)] * 6)
"""Learning rates that leave the scene as it is, so that every step does the same work."""

CORNERS = np.array(list(product((-1, 1), repeat=3)), np.float32)
"""Points that a trainer can start from, whatever scene it is given then."""


@dataclass(frozen=True)
class StepTimes:
    """Median milliseconds of a whole step, of each stage, and what the step worked on.

    step: of a stream of steps; render: of a picture alone, from the camera to the host's array;
    launches: kernels of a step.
    """

    step: float
    render: float
    launches: int
    stages: dict[str, float]
    anchors: int
    gaussians: int
    intersections: int


def bench_step(
    device: Device, gaussians: int, size: int | tuple[int, int], repeats: int, seed: int
) -> StepTimes:
    """Time steps on a new synthetic scene, as :func:`time_steps` does."""
    return time_steps(synthetic_trainer(device, gaussians, size, seed), repeats)


def time_steps(trainer: Trainer, repeats: int) -> StepTimes:
    """Time ``repeats`` steps as a stream, then as many stage by stage (with waits in between)."""
    device = trainer.device
    before = device.launches
    whole = stream_times(trainer, repeats)
    launches = round((device.launches - before) / (WARM_UP + repeats))
    device.profile.clear()
    device.profile.enabled = True
    for _ in range(repeats):
        trainer.step()
    device.profile.enabled = False
    stages = {name: milliseconds for name, _, milliseconds, _ in device.profile.rows()}
    counts = count_frame(device, trainer.render_next())
    return StepTimes(
        median(whole),
        median(render_times(trainer, repeats)),
        launches,
        stages,
        trainer.parameters.count,
        counts.gaussians,
        counts.intersections,
    )


def stream_times(trainer: Trainer, repeats: int) -> list[float]:
    """Milliseconds between the results of ``repeats`` steps after a few to warm up."""
    start, times = 0.0, []
    for _ in trainer.steps(WARM_UP + repeats):
        now = time.perf_counter()
        times.append(1e3 * (now - start))
        start = now
    return times[WARM_UP:]


def render_times(trainer: Trainer, repeats: int) -> list[float]:
    """Milliseconds of ``repeats`` pictures of the first view, after a few to warm up."""
    camera, settings = trainer.dataset.train[0].camera, trainer.settings
    scene = trainer.queue.seen(trainer.parameters, trainer.steps_done)
    renderer = Renderer.of_device_scene(trainer.device, scene, settings, trainer.options)
    times = []
    for _ in range(WARM_UP + repeats):
        start = time.perf_counter()
        renderer.render(camera)
        times.append(1e3 * (time.perf_counter() - start))
    return times[WARM_UP:]


def synthetic_trainer(
    device: Device, gaussians: int, size: int | tuple[int, int], seed: int
) -> Trainer:
    """A trainer in the middle of its statistics phase, on a synthetic scene and photo."""
    return trainer_of(device, *anchor_scene(gaussians, size, seed), seed)


def trainer_of(device: Device, scene: Scene, camera: Camera, seed: int = 0) -> Trainer:
    """As :func:`synthetic_trainer`, of a scene and a camera of one's own."""
    dataset = photo_dataset(camera, CORNERS, seed)
    config = replace(TrainConfig(), learning_rates=STILL, seed=seed).for_dataset("photos")
    trainer = Trainer(device, dataset, config)
    trainer.parameters = new_parameters(device, scene.anchors, scene.mlps)
    trainer.densifier = Densifier(device, config, trainer.parameters.count)
    trainer.steps_done = config.statistics_start + 1
    trainer.rng = np.random.default_rng(seed)
    return trainer
