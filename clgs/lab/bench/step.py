"""`clgs bench step`: time one training step on a seeded synthetic scene, stage by stage."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median

from clgs.lab.figures import show_table, take_turns, write_figures
from clgs.lab.savings import Saving, savings
from clgs.lab.scenes import anchor_scene
from clgs.opencl.device import Device
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import Scene
from clgs.train.config import LearningRates, TrainConfig
from clgs.train.run.load import state_of_scene
from clgs.train.run.trainer import Trainer
from clgs.workflow.runs.clocks import photo_dataset

WARM_UP = 3
STILL = LearningRates(*[(1e-12, 1e-12)] * 6)
"""Learning rates that leave the scene as it is, so that every step does the same work."""


@dataclass(frozen=True)
class StepTimes:
    """Median milliseconds of a training step, and what the step worked on.

    step: one step of a stream of steps. render: one picture, from the camera to the host's array.
    launches: kernels per step. waits: how often the host waits for the device per step, the mean.
    host: processor time of the host per step, without these waits. kernels: by the device's clock,
    by name. stages: by stage, with a wait after each.
    """

    step: float
    render: float
    launches: int
    waits: float
    host: float
    kernels: dict[str, float]
    stages: dict[str, float]
    anchors: int
    gaussians: int
    intersections: int


def run(
    gaussians: int,
    size: tuple[int, int],
    repeats: int,
    seed: int,
    device: str | None,
    json: Path | None,
) -> None:
    """Measure, print and, if asked, write JSON."""
    opened = Device(device)
    trainer = synthetic_trainer(opened, gaussians, size, seed)
    times, saved = time_steps(trainer, repeats), savings(trainer)
    title = (
        f"{opened.name} ({opened.specialisation}): {times.anchors:,} anchors, "
        f"{times.gaussians:,} Gaussians, {times.intersections:,} intersections, "
        f"{size[0]}x{size[1]} px"
    )
    show(title, times, saved)
    write_figures(json, {**asdict(times), "savings": list(map(asdict, saved))}, opened)


def show(title: str, times: StepTimes, saved: list[Saving]) -> None:
    """Print the tables of the times and of what skips save."""
    rows = [
        *((name, f"{milliseconds:.2f}") for name, milliseconds in times.stages.items()),
        (),
        ("whole step", f"{times.step:.2f}"),
        ("render only", f"{times.render:.2f}"),
        (),
        ("kernels of a step, by the device's clock", f"{sum(times.kernels.values()):.2f}"),
        ("host in a step, without waits", f"{times.host:.2f}"),
        ("waits in a step", f"{times.waits:.1f}"),
        ("launches of a step", str(times.launches)),
    ]
    show_table(title, ("stage", "median ms"), rows)
    counts = [(f"{one.skip}: {one.unit}", f"{one.done:,} of {one.without:,}") for one in saved]
    show_table("work that is done with each skip", ("skip", "done"), counts)


def time_steps(trainer: Trainer, repeats: int) -> StepTimes:
    """Time ``repeats`` steps as a stream, then as many stage by stage (with waits in between)."""
    device = trainer.device
    launches, waits = device.launches, device.waits.count
    whole, host = zip(*stream(trainer, repeats), strict=True)
    launches, waits = device.launches - launches, device.waits.count - waits
    kernels = kernel_times(trainer, repeats)
    device.profile.clear()
    device.profile.enabled = True
    for _ in range(repeats):
        trainer.step()
    device.profile.enabled = False
    stages = {name: milliseconds for name, _, milliseconds, _ in device.profile.rows()}
    held = trainer.render_next().needed(device)
    return StepTimes(
        step=median(whole),
        render=median(render_times(trainer, repeats)),
        launches=round(launches / (WARM_UP + repeats)),
        waits=waits / (WARM_UP + repeats),
        host=median(host),
        kernels=kernels,
        stages=stages,
        anchors=trainer.parameters.count,
        gaussians=held.gaussians,
        intersections=held.entries,
    )


def stream(trainer: Trainer, repeats: int) -> list[tuple[float, float]]:
    """Milliseconds between the results of ``repeats`` steps after a few to warm up.

    By the clock, and of the host's processor outside of waits for the device.
    """
    waits, times = trainer.device.waits, []
    start = busy = waited = 0.0
    for _ in trainer.steps(WARM_UP + repeats):
        now, used, idle = time.perf_counter(), time.thread_time(), waits.seconds
        times.append((1e3 * (now - start), 1e3 * (used - busy - (idle - waited))))
        start, busy, waited = now, used, idle
    return times[WARM_UP:]


def kernel_times(trainer: Trainer, repeats: int) -> dict[str, float]:
    """Median milliseconds of a step by kernel, by the clock of the device."""
    found: dict[str, list[float]] = {}
    with trainer.device.timed_kernels() as times:
        for _ in range(repeats):
            trainer.step()
            for kernel, milliseconds in times.take().items():
                found.setdefault(kernel, []).append(milliseconds)
    return {kernel: median(each) for kernel, each in found.items()}


def render_times(trainer: Trainer, repeats: int) -> list[float]:
    """Milliseconds of ``repeats`` pictures of the first view, after a few to warm up."""
    camera, settings = trainer.dataset.train[0].camera, trainer.settings
    scene = trainer.rounding.scene_at(trainer.state, trainer.steps_done)
    renderer = Renderer.of_device_scene(trainer.device, scene, settings, trainer.options)
    return take_turns({"": partial(renderer.render, camera)}, repeats, WARM_UP)[""]


def synthetic_trainer(
    device: Device, gaussians: int, size: int | tuple[int, int], seed: int
) -> Trainer:
    """A trainer in the middle of its statistics phase, on a synthetic scene and photo."""
    return trainer_of(device, *anchor_scene(gaussians, size, seed), seed)


def trainer_of(device: Device, scene: Scene, camera: Camera, seed: int = 0) -> Trainer:
    """Like :func:`synthetic_trainer`, but on the scene and the camera that are given."""
    dataset = photo_dataset(camera, scene.anchors.position, seed)
    config = replace(TrainConfig(), learning_rates=STILL, seed=seed).for_dataset("photos")
    state = state_of_scene(device, dataset, config, scene, config.statistics_start + 1)
    return Trainer(device, dataset, config, state=state)
