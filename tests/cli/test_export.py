"""`clgs export`: what it chooses by the suffix, and what it says."""

from __future__ import annotations

import re

import numpy as np
import pytest

from clgs.cli import main as cli
from clgs.data.ply.gaussians import read_gaussians
from clgs.exports.splats.ply import encode_ply
from clgs.lab.anchor_scene import anchor_scene
from clgs.scene.anchors import QuantizationScales, quantize
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import save_scene
from tests.exports.splats.cases import differences, gaussians


@pytest.fixture
def work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "splats.ply").write_bytes(encode_ply(gaussians()).data)
    (tmp_path / "old.ply").write_bytes(b"old")
    (tmp_path / "old.spz").write_bytes(b"old")
    (tmp_path / "photos").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (
            "splats.ply -o x.obj",
            2,
            "x.obj: nothing is written by this suffix; take one of .glb, .html, .ply, .spz, .sog",
        ),
        ("old.spz -o x.ply", 3, "old.spz: such files are written, not read; name a .clgs or .ply"),
        ("-o x.ply", 2, "a scene is needed: `clgs export SCENE -o x.ply`"),
        ("splats.ply -o old.ply", 2, "old.ply: exists already; add --overwrite"),
        ("splats.ply -o splats.ply --overwrite", 2, "splats.ply: "),
        ("none.clgs -o x.spz", 3, "none.clgs: no such file or folder"),
        ("photos -o x.spz", 3, "photos: holds no scene.npz; name a run folder; a data set is"),
        ("photos -o x.html", 3, "photos: is a folder without scene.clgs; name a run folder"),
        ("splats.ply -o x.html", 3, "splats.ply: a page is made of a .clgs file; `clgs pack`"),
        ("old.ply -o x.spz", 3, "old.ply: not a PLY file"),
        (
            "splats.ply -o x.ply --sh-degree 4",
            2,
            "--sh-degree: 4 is not a whole number from 0 to 3",
        ),
        ("splats.ply -o x.ply --steps -1", 2, "--steps"),
        ("splats.ply -o no/x.spz", 2, "no/x.spz: cannot be written"),
    ],
)
def test_what_cannot_be_done_is_refused_in_a_line(work, capsys, words, code, said):
    try:
        found = cli.main(["export", *words.split()])
    except SystemExit as stop:  # from argparse
        found = stop.code
    assert found == code
    error = capsys.readouterr().err
    assert said in error
    assert not (work / "x.spz").exists()
    assert (work / "old.ply").read_bytes() == b"old"


def test_splats_of_a_lower_degree(work, capsys):
    assert cli.main(["export", "splats.ply", "-o", "x.ply", "--sh-degree", "0"]) == 0
    assert "degree 0" in capsys.readouterr().out
    found, whole = read_gaussians(work / "x.ply"), gaussians()
    assert (found.degree, whole.degree) == (0, 3)
    assert np.array_equal(found.sh, whole.sh[:, :1])


@pytest.mark.parametrize("suffix", ["ply", "spz", "sog", "glb"])
def test_splats_are_converted(work, capsys, suffix):
    assert cli.main(["export", "splats.ply", "-o", f"x.{suffix}"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"x.{suffix}: 500 Gaussians, degree 3"
    assert re.fullmatch(r"converted: 0\.\d MB", lines[1])
    if suffix == "ply":
        assert max(differences(read_gaussians(work / "x.ply"), gaussians()).values()) < 1e-6


def test_a_scene_without_data_is_baked_and_says_so(work, capsys):
    scene, _ = anchor_scene(300, 64, 5)
    scales = QuantizationScales()
    integers = QuantizedScene(quantize(scene.anchors, scales), scene.mlps, scales, scene.settings)
    save_scene("scene.npz", integers)
    words = ["export", "scene.npz", "-o", "x.ply", "--sh-degree", "1", "--steps", "2"]
    assert cli.main(words) == 0
    said = capsys.readouterr()
    assert "without --data cameras around the scene are assumed" in said.err
    assert re.fullmatch(
        r"x\.ply: \d+ Gaussians, degree 1\n"
        r"baked: \d+\.\d\d dB against renders of the scene, \d\.\d MB\n",
        said.out,
    )
    assert read_gaussians(work / "x.ply").degree == 1
