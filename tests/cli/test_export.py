"""`clgs export`: what it chooses by the suffix, and what it says."""

import re
from dataclasses import replace

import numpy as np
import pytest

from clgs.cli import main as cli
from clgs.data.splats.gaussians import load_splats
from clgs.exports.splats.ply import encode_ply
from clgs.lab.scenes import anchor_scene
from clgs.scene.anchors import QuantizationScales, quantize
from clgs.scene.scene import QuantizedScene, SceneTransform
from clgs.scene.storage import save_scene
from tests.codec.scenes import random_scene
from tests.exports.splats.cases import differences, gaussians
from tests.exports.test_glb import parse
from tests.small_scene import write_scene


@pytest.fixture
def work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "splats.ply").write_bytes(encode_ply(gaussians()).data)
    save_scene(tmp_path / "s.npz", random_scene(np.random.default_rng(3), 40))
    (tmp_path / "old.ply").write_bytes(b"old")
    (tmp_path / "old.spz").write_bytes(b"old")
    (tmp_path / "old.glb").write_bytes(b"old")
    (tmp_path / "empty.spz").touch()
    (tmp_path / "web.ksplat").write_bytes(bytes(64))
    far = replace(gaussians(), mean=gaussians().mean * np.float32(1e30))
    (tmp_path / "far.ply").write_bytes(encode_ply(far).data)
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
        ("old.glb -o x.ply", 3, "old.glb: such files are written, not read; name a .clgs or .ply"),
        ("old.spz -o x.ply", 3, "old.spz: not a PLY file; name one"),
        ("empty.spz -o x.ply", 3, "empty.spz: the file is empty; write the file again"),
        ("web.ksplat -o x.ply", 3, "web.ksplat: such files are not read; convert it to .ply"),
        ("far.ply -o x.spz", 3, "x.spz: a coordinate is "),
        ("-o x.ply", 2, "a scene is needed: `clgs export SCENE -o x.ply`"),
        ("splats.ply -o old.ply", 2, "old.ply: exists already; add --overwrite"),
        ("splats.ply -o splats.ply --overwrite", 2, "splats.ply: "),
        ("none.clgs -o x.spz", 3, "none.clgs: no such file or folder"),
        ("photos -o x.spz", 3, "photos: holds no scene.npz; name a run folder; a data set is"),
        ("photos -o x.html", 3, "photos: is a folder without scene.clgs; name a run folder"),
        ("old.ply -o x.spz", 3, "old.ply: not a PLY file"),
        (
            "splats.ply -o x.ply --sh-degree 4",
            2,
            "--sh-degree: 4 is not a whole number from 0 to 3",
        ),
        ("splats.ply -o x.ply --steps -1", 2, "--steps"),
        ("splats.ply -o x.ply --steps 9", 2, "--steps: splats are converted, not baked; leave it"),
        ("splats.ply -o x.spz --max-size 90", 2, "--max-size: splats are converted, not baked"),
        ("splats.ply -o x.spz --antialiased", 2, "--antialiased: splats are converted, not baked"),
        ("splats.ply -o x.html --antialiased", 2, "--antialiased: a page holds the scene as it is"),
        ("splats.ply -o x.glb --device 0", 2, "--device: splats are converted, not baked"),
        ("splats.ply -o x.spz --data photos", 2, "--data: only .glb has an up, which a data set"),
        ("splats.ply -o x.glb --data none", 3, "none: no such folder"),
        ("splats.ply -o x.ply --name me", 2, "--name: only a page has a title; leave it out"),
        ("splats.ply -o x.html --units scene", 2, "--units: a page holds the scene as it is"),
        ("photos -o x.glb --sh-degree 1", 2, "--sh-degree: photos is a data set; leave it out"),
        ("s.npz -o x.spz --downscale 2", 2, "--downscale: no photos are known without --data"),
        ("s.npz -o x.ply --max-size 90", 2, "--max-size: no photos are known without --data"),
        ("s.npz -o x.glb --masks object", 2, "--masks: no photos are known without --data"),
        ("splats.ply -o no/x.spz", 2, "no/x.spz: cannot be written"),
    ],
)
def test_what_cannot_be_done_is_refused_in_a_line(work, refusal, words, code, said):
    assert said in refusal(code, "export", *words.split())
    assert not (work / "x.spz").exists()
    assert (work / "old.ply").read_bytes() == b"old"


def test_splats_of_a_lower_degree(work, output_of):
    assert "degree 0" in output_of("export", "splats.ply", "-o", "x.ply", "--sh-degree", "0")
    found, whole = load_splats(work / "x.ply").gaussians, gaussians()
    assert (found.degree, whole.degree) == (0, 3)
    assert np.array_equal(found.sh, whole.sh[:, :1])


@pytest.mark.parametrize("suffix", ["ply", "spz", "sog", "glb"])
def test_splats_are_converted(work, output_of, suffix):
    lines = output_of("export", "splats.ply", "-o", f"x.{suffix}").splitlines()
    assert lines[0] == f"x.{suffix}: 500 Gaussians, degree 3"
    assert re.fullmatch(r"converted: 0\.\d MB", lines[1])
    if suffix == "ply":
        assert max(differences(load_splats(work / "x.ply").gaussians, gaussians()).values()) < 1e-6


@pytest.mark.slow
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
    assert load_splats(work / "x.ply").gaussians.degree == 1


def test_a_data_set_turns_the_axes_of_splats(work, tmp_path):
    photos = write_scene(tmp_path / "set", train=3, test=1)
    assert cli.main(["export", "splats.ply", "-o", "x.glb", "--data", str(photos)]) == 0
    document, _ = parse((work / "x.glb").read_bytes())
    assert document["nodes"][0]["matrix"] == [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]


@pytest.mark.parametrize("suffix", ["ply", "spz", "sog", "glb"])
def test_splats_far_from_the_origin_are_told(work, capsys, suffix):
    encoded = encode_ply(gaussians(), SceneTransform((5e5, 5.4e5, 120.0)))
    (work / "far.ply").write_bytes(encoded.data)
    assert cli.main(["export", "far.ply", "-o", f"x.{suffix}"]) == 0
    said = capsys.readouterr().err
    assert ("--units scene puts their middle at the origin" in said) == (suffix != "glb")
    assert cli.main(["export", "far.ply", "-o", f"y.{suffix}", "--units", "scene"]) == 0
    assert capsys.readouterr().err == ""
    if suffix != "glb":
        assert load_splats(work / f"y.{suffix}").transform == SceneTransform()
        assert load_splats(work / f"x.{suffix}").transform.centre[1] == pytest.approx(5.4e5, abs=9)


def test_marks_of_antialiased_splats_are_kept(work, capsys):
    marked = encode_ply(replace(gaussians(), antialiased=True)).data
    (work / "aa.ply").write_bytes(marked)
    assert cli.main(["pack", "aa.ply", "-o", "aa.clgs"]) == 0
    for source in ("aa.ply", "aa.clgs"):
        for suffix in ("ply", "spz", "sog"):
            words = ["export", source, "-o", f"x.{suffix}", "--overwrite"]
            assert cli.main(words) == 0
            assert load_splats(work / f"x.{suffix}").gaussians.antialiased
    capsys.readouterr()
    assert cli.main(["export", "aa.ply", "-o", "x.glb"]) == 0
    assert ".glb has no mark for antialiased splats" in capsys.readouterr().err


def test_a_page_of_splats_is_that_of_their_packed_file(work, capsys):
    assert cli.main(["export", "splats.ply", "-o", "x.html"]) == 0
    assert cli.main(["export", "splats.ply", "-o", "x.spz"]) == 0
    assert cli.main(["pack", "splats.ply", "-o", "splats.clgs"]) == 0
    assert cli.main(["export", "splats.clgs", "-o", "y.html"]) == 0
    assert cli.main(["pack", "x.spz", "-o", "z.clgs"]) == 0
    assert (work / "x.html").read_bytes() == (work / "y.html").read_bytes()
