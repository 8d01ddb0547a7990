"""The examples run, at a tiny size."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install clgs[torch]")

import clgs  # noqa: E402
from tests.data.folders import write_colmap  # noqa: E402

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


def test_a_pose_is_refined(capsys):
    error = run("refine_pose.py", "--steps", 80, "--size", 64)
    first = float(capsys.readouterr().out.splitlines()[0].split()[-1])
    assert error < first / 4


def test_splats_are_trained_and_resumed(tmp_path, capsys):
    pytest.importorskip("gsplat", reason="gsplat is not installed: pip install gsplat")
    write_colmap(tmp_path / "data")
    run("train_splats.py", tmp_path / "data", tmp_path / "out", "--steps", 3)
    first = clgs.load_splats(tmp_path / "out" / "splats.ply").gaussians
    run("train_splats.py", tmp_path / "data", tmp_path / "out", "--steps", 5)
    second = clgs.load_splats(tmp_path / "out" / "splats.ply").gaussians
    assert len(first) == len(second)
    assert not np.array_equal(first.mean, second.mean)
    assert "step 0:" in capsys.readouterr().out
