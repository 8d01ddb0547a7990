"""A batch of views has the same bits wherever its views are looked at."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest

import clgs
from clgs.data.dataset import load_dataset
from clgs.errors import DataError, UsageError
from clgs.opencl.device import Device
from clgs.reference import adam as adam_reference
from clgs.render.frame import EXACT_ROOM, Room
from clgs.train.config import preset
from clgs.train.run.session import train_scene
from clgs.train.run.trainer import NonFiniteLossError, Trainer
from clgs.train.step import look
from tests.cli.calls import exit_code
from tests.small_scene import write_scene
from tests.train.state.test_run_state import arrays_of
from tests.train.step.test_masks import masked

STEPS = 120
"""Steps of a whole run; anchors grow at step 50 and become integers after step 60."""


@pytest.fixture(scope="module")
def halves(open_device):
    """Two devices that stand for two cards: halves of the CPU, each with a context of its own."""
    whole = open_device("cpu").cl_device
    if whole.max_compute_units < 2:
        pytest.skip("a CPU of one core has no halves")
    parts = whole.create_sub_devices([cl.device_partition_property.EQUALLY, 1])
    return [Device(specialisation="cpu", cl_device=part) for part in parts[:2]]


def config(dataset, **changes):
    settings = replace(preset("default").scaled(STEPS), voxel=0.02, **{"batch": 2, **changes})
    return settings.for_dataset(dataset.kind)


def trained(settings, dataset, devices, steps):
    first, *others = devices
    trainer = Trainer(first, dataset, settings, others=others)
    results = list(trainer.steps(steps))
    state = trainer.state
    return results, arrays_of(first, state), (state.views.record(), state.rng.bit_generator.state)


@pytest.mark.slow
def test_masked_views_on_small_photos_in_groups_have_the_same_bits(dataset, cpu, halves):
    """The host waits within a look for what groups of tiles need."""
    mask = np.ones((40, 40), np.uint8)
    mask[:, :12] = 0
    changes = {"coarse_to_fine": True, "max_memory": 5, "optimizer": "numpy"}
    settings, hidden = config(dataset, **changes), masked(dataset, mask)
    whole = Trainer(cpu, hidden, replace(settings, coarse_to_fine=False))
    assert whole.render_next().groups is not None
    wanted = trained(settings, hidden, [cpu], 52)  # photos have their size after step 42
    assert trained(settings, hidden, halves, 52) == wanted
    assert trained(settings, dataset, [cpu], 52)[1] != wanted[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes", [{}, {"exposure": True, "adam": "visible"}], ids=["usual", "exposure"]
)
def test_a_step_has_the_same_bits_wherever_it_looks(dataset, cpu, halves, changes):
    settings, (left, right) = config(dataset, background="random", **changes), halves
    steps = 70 if not changes else 45  # exposures learn from a fifth of the steps on
    wanted = trained(settings, dataset, [cpu], steps)
    for devices in ([left, right], [cpu, cpu], [right, left]):
        assert trained(settings, dataset, devices, steps) == wanted
    if changes:
        maps = np.frombuffer(wanted[1]["maps"][1], np.float32).reshape(wanted[1]["maps"][0])
        assert np.abs(maps - np.eye(3, 4)).max() > 0.005
    else:  # anchors grew, and a round removed some
        assert len({result.anchors for result in wanted[0]}) > 2
    assert all(result.view.count(", ") == 1 for result in wanted[0])


@pytest.mark.slow
def test_views_are_dealt_to_the_devices_that_are_named(dataset, cpu, halves, monkeypatch):
    settings, (left, right), seen = config(dataset, batch=5), halves, []
    enqueue = look.Looks.enqueue

    def note(self, *arguments):
        seen.append((self._device, arguments[3].index))
        return enqueue(self, *arguments)

    monkeypatch.setattr(look.Looks, "enqueue", note)
    turns = [left, right, right]
    found = trained(settings, dataset, turns, 8)
    steps, devices = [seen[i : i + 5] for i in range(0, 40, 5)], [*turns, *turns[:2]]
    names = [view.name for view in dataset.train]
    for looks, result in zip(steps, found[0], strict=True):
        order = [names.index(name) for name in result.view.split(", ")]
        assert sorted(order, key=order.index) == order
        assert len(set(order)) == 5
        where = dict(zip(order, devices, strict=True))
        assert all(where[index] is device for device, index in looks)
    assert found == trained(settings, dataset, [cpu], 8)


def test_the_mean_gradient_moves_the_scene_as_adam_does(dataset, cpu):
    """The first step, against float64: root of the batch, betas to its power."""
    settings, gradients = config(dataset, batch=3), []
    trainer = Trainer(cpu, dataset, settings)
    before = cpu.download(trainer.parameters.scene.anchors.scaling).astype(np.float64)
    alone = Trainer(cpu, dataset, settings)
    given = alone.queue.next_input(alone.state, 1)
    for view in given.views:
        found = alone.queue._looks.enqueue(
            alone.parameters.scene, None, 1, view, EXACT_ROOM
        ).gradients
        gradients.append(cpu.download(found.d_scaling).astype(np.float64))
    list(trainer.steps(1))
    first, last = settings.learning_rates.scaling
    rate = first * (last / first) ** (1 / settings.learning_rate_steps) * 3**0.5
    zero, mean = np.zeros_like(before), np.mean(gradients, axis=0)
    betas = 0.9**3, 0.999**3
    wanted, moments = adam_reference.step(before, mean, (zero, zero), rate, 1, betas=betas)
    seen = np.abs(mean) > 1e-4 * np.abs(mean).max()
    assert seen.mean() > 0.05
    moved = cpu.download(trainer.parameters.scene.anchors.scaling) - before
    assert moved[seen] == pytest.approx((wanted - before)[seen], rel=1e-3)
    second = cpu.download(trainer.parameters.moments["scaling"].second)
    assert second[seen] == pytest.approx(moments[1][seen], rel=1e-3)


@pytest.mark.slow
def test_steps_that_lack_room_on_any_device_are_repeated(dataset, cpu, halves):
    settings = config(dataset, background="random")
    wanted = trained(settings, dataset, [cpu], 40)
    for devices in (halves, [cpu, cpu]):
        trainer = Trainer(devices[0], dataset, settings, others=devices[1:])
        results, repeats, clear = [], [], trainer.queue.clear
        trainer.queue.clear = lambda repeats=repeats, clear=clear: (repeats.append(1), clear())
        for result in trainer.steps(40):
            results.append(result)
            if result.step % 13 == 0:
                trainer.queue.room = Room(8, 8, 8)
        assert len(repeats) >= 3
        assert (results, arrays_of(devices[0], trainer.state)) == wanted[:2]


@pytest.mark.parametrize("place", [0, 1])
def test_numbers_that_are_not_finite_on_any_device_change_nothing(
    dataset, halves, monkeypatch, place
):
    trainer = Trainer(halves[0], dataset, config(dataset), others=halves[1:])
    list(trainer.steps(3))
    before, backward = arrays_of(halves[0], trainer.state), look.rasterise_backward

    def broken(device, *arguments):
        gradients = backward(device, *arguments)
        if device is halves[place]:
            shape = gradients.d_scaling.shape
            device.write(gradients.d_scaling, np.full(shape, np.inf, np.float32))
        return gradients

    monkeypatch.setattr(look, "rasterise_backward", broken)
    with pytest.raises(
        NonFiniteLossError, match=r"gradient is not finite at step 4, view .*, .*r_"
    ):
        list(trainer.steps(3))
    assert arrays_of(halves[0], trainer.state) == before


KILLED = """
import os, signal, sys
import pyopencl as cl
from clgs.data.dataset import load_dataset
from clgs.opencl.device import Device
from clgs.train.config import from_toml
from clgs.train.run.session import train_scene

data, run, settings = sys.argv[1:]
parts = Device().cl_device.create_sub_devices([cl.device_partition_property.EQUALLY, 1])
devices = [Device(specialisation="cpu", cl_device=part) for part in parts[:2]]

def die(progress):
    if progress.result.step == 57:
        os.kill(os.getpid(), signal.SIGKILL)

train_scene(load_dataset(data), run, from_toml(settings), devices=devices, on_progress=die)
"""


@pytest.mark.slow
def test_a_killed_run_ends_in_the_same_file_on_other_devices(cpu, halves, tmp_path):
    data = write_scene(tmp_path / "data")
    dataset = load_dataset(data)
    settings = replace(
        preset("default").scaled(80),
        voxel=0.02,
        checkpoint_interval=25,
        start_points=2000,
        target_size=17_000,
    )
    code = [sys.executable, "-c", KILLED, str(data), str(tmp_path / "run")]
    killed = subprocess.run([*code, settings.to_toml()], check=False, cwd=Path(__file__).parents[3])
    assert killed.returncode == -signal.SIGKILL
    saved = [path.name for path in (tmp_path / "run" / "checkpoint").iterdir()]
    assert "step_00000050.npz" in saved
    settings = replace(settings, batch=2)
    legs = train_scene(dataset, tmp_path / "run", settings, device=cpu, resume=True)
    whole = train_scene(dataset, tmp_path / "whole", settings, devices=halves)
    assert legs.bitstream == whole.bitstream
    assert len(whole.bitstream) <= 17_000
    assert legs.summary["digest"] == whole.summary["digest"]
    assert (legs.summary["batch"], whole.summary["device"].count(", ")) == (2, 1)
    with pytest.raises(DataError, match=r"other settings or photos \(--batch: 2 there, 3 here\)"):
        train_scene(dataset, tmp_path / "run", replace(settings, batch=3), device=cpu, resume=True)


def test_devices_that_cannot_be_used_are_one_line(dataset, open_device, tmp_path, capsys):
    data, run = write_scene(tmp_path / "data", train=2), tmp_path / "run"
    count = len(clgs.opencl.choose.list_devices())
    for words, code, said in (
        (["--devices", f"0,{count}"], 4, f"--devices {count} matches no OpenCL device; available"),
        (["--devices", "0,"], 2, "--devices: the name is empty"),
        (["--devices", "0,0,0"], 2, "batch: 3 views per step, but there are 2 training photos"),
        (["--devices", "0,0,0", "--batch", "2"], 2, "batch: 2 views per step leave some of 3"),
        (["--devices", "0,0", "--device", "0"], 2, "not allowed with argument --device"),
        (["--devices", "0,0", "--blocks", "2x2"], 2, "--devices: not with --blocks"),
        (["--batch", "2", "--blocks", "2x2"], 2, "--batch: blocks are trained side by side"),
        (["--batch", "0"], 2, "0 is out of range; give a whole number from 1 to 1024"),
    ):
        assert exit_code(["train", str(data), "-o", str(run), "--steps", "20", *words]) == code
        (line,) = [one for one in capsys.readouterr().err.splitlines() if "error: " in one]
        assert said in line
        assert not run.exists()
    with pytest.raises(UsageError, match=r"cpu kernels.*gpu kernels.*not compute the same bits"):
        train_scene(dataset, run, devices=[open_device("cpu"), open_device("gpu")])
    with pytest.raises(UsageError, match="name one of both"):
        train_scene(dataset, run, device=open_device("cpu"), devices=[open_device("cpu")])
    assert not run.exists()


@pytest.mark.slow
def test_the_command_trains_on_a_device_named_twice(tmp_path, capsys):
    data = write_scene(tmp_path / "data")
    base = ["train", str(data), "--steps", "12", "--set", "voxel=0.05", "--start-points", "500"]
    assert exit_code([*base, "-o", str(tmp_path / "twice"), "--devices", "0,0"]) == 0
    assert exit_code([*base, "-o", str(tmp_path / "batch"), "--batch", "2", "--device", "0"]) == 0
    files = [(tmp_path / name / "scene.clgs").read_bytes() for name in ("twice", "batch")]
    assert files[0] == files[1]
    assert re.search(r"^batch = 2$", (tmp_path / "twice" / "config.toml").read_text(), re.MULTILINE)
    capsys.readouterr()
    again = [*base, "-o", str(tmp_path / "twice"), "--devices", "0,0", "--resume"]
    assert exit_code(again) == 0
    assert "is finished already" in capsys.readouterr().out
    further = ["train", str(data), "--from", str(tmp_path / "twice"), "-o", str(tmp_path / "more")]
    assert exit_code([*further, "--steps", "14", "--lambda", "9"]) == 0
    assert "lambda: 9 changes nothing, 14 steps come to no round that" in capsys.readouterr().err
    assert re.search(r"^batch = 2$", (tmp_path / "more" / "config.toml").read_text(), re.MULTILINE)
