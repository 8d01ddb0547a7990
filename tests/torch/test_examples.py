"""The examples run, at a tiny size."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install clgs[torch]")

import clgs  # noqa: E402
from tests.data.folders import write_colmap  # noqa: E402
from tests.small_scene import write_scene  # noqa: E402

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(name, *arguments):
    return runpy.run_path(str(EXAMPLES / name))["main"]([str(one) for one in arguments])


def test_an_image_is_fitted(tmp_path, capsys):
    ramp = np.linspace(0, 255, 48)[:, None, None] * np.ones((1, 64, 3))
    Image.fromarray(ramp.astype(np.uint8)).save(tmp_path / "photo.png")
    arguments = tmp_path / "photo.png", tmp_path / "out.png", "--gaussians", 200, "--steps", 60
    run("fit_image.py", *arguments)
    found = [float(line.split()[3]) for line in capsys.readouterr().out.splitlines()]
    assert found[-1] > found[0] + 5
    assert Image.open(tmp_path / "out.png").size == (64, 48)


def test_a_pose_is_refined(tmp_path, capsys):
    file = tmp_path / "poses.png"
    error = run("refine_pose.py", "--steps", 80, "--size", 64, "--picture", file)
    first = float(capsys.readouterr().out.splitlines()[0].split()[-1])
    assert error < first / 4
    _, before, after = np.split(np.asarray(Image.open(file), float), 3, axis=1)
    assert after.mean() < before.mean() / 4


def test_splats_are_trained_and_resumed(tmp_path, capsys):
    pytest.importorskip("gsplat", reason="gsplat is not installed: pip install gsplat")
    write_colmap(tmp_path / "data")
    run("train_splats.py", tmp_path / "data", tmp_path / "out", "--steps", 3)
    first = clgs.load_splats(tmp_path / "out" / "splats.ply").gaussians
    run("train_splats.py", tmp_path / "data", tmp_path / "out", "--steps", 5)
    second = clgs.load_splats(tmp_path / "out" / "splats.ply").gaussians
    assert len(first) == len(second)
    assert not np.array_equal(first.mean, second.mean)
    arguments = "--steps", 9, "--minutes", 0
    run("train_splats.py", tmp_path / "data", tmp_path / "out", *arguments)
    found = capsys.readouterr().out
    assert "step 0:" in found
    assert "held out after 5 steps" in found.splitlines()[-1]


def test_splats_begin_without_points_of_the_data(tmp_path, capsys):
    pytest.importorskip("gsplat", reason="gsplat is not installed: pip install gsplat")
    folder = write_scene(tmp_path / "balls", train=4, test=1, size=24)
    run("train_splats.py", folder, tmp_path / "out", "--steps", 2)
    assert "held out after 2 steps" in capsys.readouterr().out


def test_splats_begin_as_wide_as_their_nearest_neighbours_are_away(rng):
    """Far from the origin, too, and if one point is far from all others."""
    points = np.float32(100) + rng.uniform(-1, 1, (600, 3)).astype(np.float32)
    points[-1] += 50
    start = runpy.run_path(str(EXAMPLES / "train_splats.py"))["start"]
    scales = start(torch.tensor(points), torch.zeros(600, 3))["scales"].detach().numpy()
    exact = points.astype(float)
    away = np.linalg.norm(exact[:, None] - exact, axis=-1)
    nearest = np.sort(away, axis=1)[:, 1:4].mean(axis=1)
    assert np.allclose(np.exp(scales), nearest[:, None], rtol=1e-4)


def test_a_scene_of_anchors_is_trained_by_a_loss_of_its_own(tmp_path, capsys):
    folder = write_scene(tmp_path / "balls", train=4, test=1, size=24)
    config = replace(clgs.preset("quick").scaled(8), start_points=300)
    clgs.train_scene(clgs.load_dataset(folder), tmp_path / "run", config)
    given, made = tmp_path / "run" / "scene.clgs", tmp_path / "out.clgs"
    picture = tmp_path / "depth.png"
    arguments = given, folder, made, "--steps", 8, "--picture", picture
    before, after = run("train_anchors.py", *arguments)
    assert after > before
    assert "roughness" in capsys.readouterr().out
    old, new = clgs.decode(given.read_bytes()), clgs.decode(made.read_bytes())
    assert np.array_equal(old.anchors.position, new.anchors.position)
    assert not np.array_equal(old.mlps.flat, new.mlps.flat)
    assert Image.open(picture).size == (48, 24)
