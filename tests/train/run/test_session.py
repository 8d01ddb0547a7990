"""A run that is interrupted at any moment ends as if it had not been."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import clgs
from clgs.errors import DataError, ExistsError, UsageError
from clgs.lab.scenes import anchor_scene
from clgs.train.config import preset
from clgs.train.run.session import train_scene
from tests.codec.scenes import random_scene
from tests.small_scene import write_scene

STEPS = 160
README = Path(__file__).parents[3] / "README.md"


def config():
    return replace(preset("default").scaled(STEPS), voxel=0.05, log_interval=50)


def interrupt_at(step):
    def on_progress(progress):
        if progress.result.step == step:
            os.kill(os.getpid(), signal.SIGINT)

    return on_progress


@pytest.fixture(scope="module")
def short(dataset, open_device, tmp_path_factory):
    """The folder of a whole run, and its results."""
    folder = tmp_path_factory.mktemp("runs") / "short"
    return folder, train_scene(dataset, folder, config(), device=open_device("cpu"))


@pytest.mark.slow
def test_interrupted_runs_end_alike(dataset, open_device, short, tmp_path):
    device, (_, whole) = open_device("cpu"), short
    for step in (60, 115):
        with pytest.raises(KeyboardInterrupt):
            train_scene(
                dataset,
                tmp_path / "legs",
                config(),
                device=device,
                resume=True,
                on_progress=interrupt_at(step),
            )
    legs = train_scene(dataset, tmp_path / "legs", config(), device=device, resume=True)
    assert legs.bitstream == whole.bitstream
    seconds = legs.summary["train_seconds"]
    assert seconds > 0
    rows = (tmp_path / "legs" / "progress.csv").read_text().splitlines()
    steps = [int(row.split(",")[0]) for row in rows[1:]]
    assert steps == sorted(steps)
    # other photos under the same name: the checkpoint is refused
    other = replace(dataset, points=dataset.points[:-5])
    with pytest.raises(DataError, match="other settings or photos"):
        train_scene(other, tmp_path / "legs", config(), device=device, resume=True)


@pytest.mark.slow
@pytest.mark.parametrize("kept", [True, False])
def test_a_finished_run_is_trained_on(dataset, open_device, short, tmp_path, kept):
    """It goes on from the checkpoint or the scene, with other settings, and after a break."""
    device, first, more = open_device("cpu"), tmp_path / "first", tmp_path / "more"
    folder, short = short
    shutil.copytree(folder, first)
    if not kept:
        (first / "checkpoint" / f"step_{STEPS:08}.npz").unlink()
    before = {path: path.read_bytes() for path in first.rglob("*") if path.is_file()}
    longer = replace(config().scaled(STEPS * 3 // 2), size_lambda=0.5, exposure=kept)
    options = {"start": first, "device": device, "resume": True}
    psnrs = []

    def look(progress):
        psnrs.append(progress.psnr)
        interrupt_at(STEPS + 20)(progress)

    with pytest.raises(KeyboardInterrupt):
        train_scene(dataset, more, longer, on_progress=look, **options)
    assert 20 <= len(psnrs) <= 21  # the device is a step ahead
    assert len(list((more / "checkpoint").iterdir())) == 1
    run = train_scene(dataset, more, longer, **options)
    assert run.summary["steps"] == STEPS * 3 // 2
    assert run.summary["psnr"] > short.summary["psnr"] - 0.5
    assert train_scene(dataset, more, longer, **options).bitstream == run.bitstream
    assert {path: path.read_bytes() for path in first.rglob("*") if path.is_file()} == before
    with pytest.raises(ExistsError, match=f"in which --from {first} trains"):
        train_scene(dataset, first, longer, device=device, resume=True)


@pytest.fixture(scope="module")
def first(dataset, open_device, tmp_path_factory):
    """A run of 40 steps."""
    folder = tmp_path_factory.mktemp("runs") / "first"
    train_scene(dataset, folder, config().scaled(40), device=open_device("cpu"))
    return folder


def test_a_damaged_run_is_not_trained_on(dataset, open_device, first, tmp_path):
    cut = shutil.copytree(first, tmp_path / "cut")
    (cut / "scene.clgs").write_bytes((first / "scene.clgs").read_bytes()[:500])
    with pytest.raises(
        DataError, match=r"cut: .* damaged \(scene.clgs has .*\); restore its files"
    ):
        train_scene(dataset, tmp_path / "new", config(), device=open_device("cpu"), start=cut)


@pytest.mark.slow
def test_anchors_of_a_much_longer_run_are_judged_anew(dataset, open_device, first, tmp_path):
    """It grows and thins them again before the switch to integers comes, later than before."""
    device, before = open_device("cpu"), json.loads((first / "results.json").read_text())
    run = train_scene(dataset, tmp_path / "long", config(), device=device, start=first)
    assert run.summary["anchors"] != before["anchors"]
    assert run.summary["psnr"] > before["psnr"]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({}, "steps: .*first has done 40, which count; give more"),
        ({"steps": 41, "position_q": 7.0, "switch_step": 30}, "position_q: positions of .*first"),
        ({"steps": 41, "box": "90,90,90,91,91,91"}, "box: .* holds none of the anchors of .*first"),
    ],
)
def test_what_cannot_be_trained_on_is_said(dataset, open_device, first, tmp_path, changed, said):
    device = open_device("cpu")
    longer = replace(config().scaled(40), **changed)
    with pytest.raises(UsageError, match=said):
        train_scene(dataset, tmp_path / "new", longer, device=device, start=first)
    with pytest.raises(DataError, match="holds no finished run"):
        train_scene(dataset, tmp_path / "new", config(), device=device, start=tmp_path)
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_progress_without_views_holds_no_psnr(dataset, open_device, tmp_path):
    few = replace(preset("default").scaled(12), voxel=0.05, log_interval=4, fixed_views=0)
    seen = []
    train_scene(dataset, tmp_path / "run", few, device=open_device("cpu"), on_progress=seen.append)
    assert {one.psnr for one in seen} == {None}
    for name in ("progress.csv", "results.json"):
        assert "nan" not in (tmp_path / "run" / name).read_text().lower(), name


@pytest.mark.slow
def test_a_run_is_replaced_only_if_asked_for_and_leaves_no_mixture(dataset, open_device, tmp_path):
    folder, device = tmp_path / "run", open_device("cpu")
    train_scene(dataset, folder, config().scaled(6), device=device)
    (folder / "notes.txt").touch()
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(DataError, match="holds a run already") as caught:
        train_scene(dataset, folder, config().scaled(4), device=device)
    assert isinstance(caught.value, ExistsError)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    run = train_scene(dataset, str(folder), config().scaled(4), device=device, overwrite=True)
    assert [path.name for path in (folder / "test").iterdir()] == ["ours_4"]
    assert [path.name for path in (folder / "checkpoint").iterdir()] == ["step_00000004.npz"]
    assert (folder / "notes.txt").exists()
    assert all(len(repr(one)) < 200 for one in (run, dataset, run.scene, run.scene.dequantize()))
    assert repr(run).startswith(f"<RunResult {folder}: {len(run.bitstream):,} bytes, ")


def test_arguments_of_other_classes_are_one_line(dataset, open_device, tmp_path):
    device, view = open_device("cpu"), dataset.train[0]
    scene, _ = anchor_scene(100, 20, 1)
    quantized = random_scene(np.random.default_rng(1), 20)
    for call, said in (
        (lambda: clgs.train_scene("DATA", tmp_path / "x"), r"dataset: is str.*load_dataset"),
        (lambda: clgs.train_scene(dataset, tmp_path / "x", "quick"), r"config: is str.*preset"),
        (lambda: clgs.encode(None), "scene: is NoneType, QuantizedScene is needed"),
        (lambda: clgs.decode("x.clgs"), r"data: is str, bytes are needed; .*read_bytes"),
        (lambda: clgs.Device(0), r'name: is int, str is needed; .*Device\("0"\)'),
        (lambda: clgs.render_view(scene, view), r"camera: is View.*view\.camera"),
        (lambda: clgs.Renderer(device, scene).render(view), r"camera: is View.*view\.camera"),
        (lambda: clgs.Renderer(device, None), r"scene: is NoneType.*dequantize"),
        (lambda: clgs.Renderer("0", scene), r"device: is str, Device is needed"),
        (lambda: clgs.evaluate_views(device, scene, []), "scene: is Scene, QuantizedScene is"),
        (lambda: clgs.evaluate_views(device, quantized, [view.camera]), "views: is Camera, View"),
        (lambda: clgs.evaluate_views(device, quantized, view), "views: is View, Sequence is"),
        (lambda: clgs.evaluate_views(device, quantized, iter([view])), "views: is list_iterator"),
        (lambda: clgs.TrainConfig(learning_rates=None), "learning_rates: is NoneType, Learning"),
        (lambda: clgs.render_view(scene, [view.camera], device), "camera: is list, Camera is"),
        (lambda: clgs.train_scene(dataset, tmp_path / "x", device="0"), "device: is str, Device"),
        (lambda: clgs.train_scene(dataset, None), "folder: None; a path is needed"),
        (lambda: clgs.load_dataset([tmp_path]), r"path: \[.*; a path is needed"),
        (lambda: clgs.load_dataset(tmp_path, max_size="9"), "max_size: '9'; an integer is needed"),
        (lambda: clgs.load_dataset(tmp_path, points_file=3), "points_file: 3; a path is needed"),
        (lambda: clgs.load_scene([]), r"path: \[\]; a path is needed"),
        (lambda: clgs.load_splats(None), "path: None; a path is needed"),
        (lambda: clgs.export(scene, tmp_path / "x.ply"), "source: <Scene.*; a path is needed"),
        (lambda: clgs.prepare([tmp_path], tmp_path / "x"), r"photos: \[.*; a path is needed"),
        (lambda: clgs.run([tmp_path], tmp_path / "x"), r"photos: \[.*; a path is needed"),
        (lambda: clgs.run(tmp_path, tmp_path / "x", seconds="5m"), "seconds: is str"),
        (lambda: clgs.run(tmp_path, tmp_path / "x", steps="5"), "steps: '5'; an integer is"),
        (lambda: clgs.render_options(["exact"]), "accuracy: is list, str is needed"),
        (lambda: clgs.train_scene(dataset, tmp_path / "x", devices=3), "devices: is int, Sequence"),
        (
            lambda: clgs.train_scene(dataset, tmp_path / "x", on_progress=3),
            "on_progress: is int; give a function",
        ),
    ):
        with pytest.raises(TypeError, match=said):
            call()
    assert not (tmp_path / "x").exists()
    with pytest.raises(UsageError, match="folder: the name is empty"):
        clgs.train_scene(dataset, "")


@pytest.mark.skipif(not README.is_file(), reason="README.md is not installed with the package")
def test_python_example_of_the_readme_runs(tmp_path, monkeypatch):
    example = re.search(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert example is not None
    write_scene(tmp_path / "DATA")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("clgs.data.points.HULL_POINTS", 3000)  # for speed
    # tests/workflow covers the functions that take minutes
    lines = example[1].splitlines()
    code = "\n".join(one for one in lines if not one.startswith(("clgs.run", "clgs.export(")))
    code = code.replace('preset("quick")', 'preset("quick").scaled(20)')
    names: dict[str, object] = {}
    exec(compile(code, "README.md", "exec"), names)
    assert (tmp_path / "scene.npz").is_file()
    assert np.asarray(names["picture"]).shape == (3, 20, 20)


def test_every_public_name_is_there():
    for name in clgs.__all__:
        assert callable(getattr(clgs, name)), name
        assert callable(getattr(clgs, name)), f"{name} after the first use"
