"""`clgs render` and `clgs eval` of clips, depth and ordinary splats, as a user runs them."""

import json

import numpy as np
import pytest
from PIL import Image

from clgs.codec.scene_encoder import encode
from clgs.codec.splat_packing import pack
from clgs.data.splats.integer_splats import read_splats
from clgs.exports.camera_path import read_camera_path
from clgs.scene.storage import save_scene
from tests.cli.test_commands import clgs
from tests.codec.scenes import random_scene
from tests.data.splats.test_gaussians import columns_of, write
from tests.ops.cases.splats import stored
from tests.small_scene import write_scene


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A data set, a scene of anchors and splats, in every form in which they are read."""
    folder = tmp_path_factory.mktemp("work")
    write_scene(folder / "data", train=6, test=2, size=24)
    scene = random_scene(np.random.default_rng(3), 40)
    save_scene(folder / "s.npz", scene)
    (folder / "s.clgs").write_bytes(encode(scene))
    path = write(folder / "splats.ply", columns_of(stored(np.random.default_rng(5), 300)))
    (folder / "run").mkdir()
    (folder / "run" / "config.toml").touch()
    (folder / "splats.clgs").write_bytes(pack(read_splats(path, {})[0]))
    return folder


@pytest.fixture
def here(work, monkeypatch):
    monkeypatch.chdir(work)
    return work


def succeed(words):
    done = clgs(*words.split())
    assert done.returncode == 0, done.stderr
    return done.stdout


def pictures(folder):
    return [np.asarray(Image.open(path)) for path in sorted(folder.glob("*.png"))]


@pytest.mark.parametrize("path", ["orbit", "spiral", "interpolate"])
def test_a_clip_has_its_frames(here, tmp_path, path):
    out = tmp_path / path
    text = succeed(f"render s.npz --data data --path {path} --frames 5 --size 40x30 -o {out}")
    assert "5 frames of 40x30, 0.2 s at 30" in text
    found = pictures(out)
    assert [picture.shape for picture in found] == [(30, 40, 3)] * 5


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["s.clgs", "splats.ply", "splats.clgs"])
def test_a_scene_needs_no_data_for_an_orbit(here, tmp_path, scene):
    out = tmp_path / "o"
    done = clgs(*f"render {scene} --path orbit --frames 3 --size 40x30 -o {out}".split())
    assert done.returncode == 0, done.stderr
    assert "up is taken to be" in done.stderr
    found = pictures(out)
    assert len(found) == 3
    assert scene == "s.clgs" or max(picture.max() for picture in found) > 20  # that one is empty
    done = clgs(*f"render {scene} --path orbit --frames 1 --up -y --size 9x9 -o {out}2".split())
    assert (done.returncode, done.stderr) == (0, "rendering 1/1\n")


def test_a_path_that_was_saved_gives_the_same_pictures(here, tmp_path):
    first, again = tmp_path / "a", tmp_path / "b"
    saved = tmp_path / "p.json"
    options = "--data data --frames 4 --size 40x30 --fps 12"
    succeed(f"render s.npz --path orbit {options} --save-path {saved} -o {first}")
    assert read_camera_path(saved)[1] == 12
    assert "at 12" in succeed(f"render s.npz --path {saved} -o {again}")
    for mine, theirs in zip(pictures(first), pictures(again), strict=True):
        assert np.abs(mine.astype(int) - theirs).max() <= 1
    succeed(f"render s.npz --path {saved} --frames 7 --size 20x20 -o {tmp_path / 'c'}")
    assert [p.shape for p in pictures(tmp_path / "c")] == [(20, 20, 3)] * 7


def test_depth_comes_as_pictures_and_as_numbers(here, tmp_path):
    views = tmp_path / "depth"
    succeed(f"render splats.ply --data data --depth -o {views}")
    names = sorted(path.name for path in views.iterdir())
    assert names == ["r_0.npy", "r_0.png", "r_1.npy", "r_1.png"]
    depth = np.load(views / "r_0.npy", allow_pickle=False)
    assert depth.dtype == np.float32
    assert depth.shape == (24, 24)
    assert 2 < np.median(depth[depth > 0]) < 6  # cameras stand 4 units from the origin
    opacity = tmp_path / "opacity"
    succeed(f"render splats.ply --data data --opacity -o {opacity}")
    shown = pictures(opacity)[0]
    assert (shown[..., 0] == shown[..., 2]).all()
    assert shown.max() > 100


def test_a_clip_replaces_all_of_an_older_one(here, tmp_path, refusal):
    words = f"render s.npz --data data --path orbit --size 16x12 -o {tmp_path} --frames"
    succeed(f"{words} 3 --depth")
    assert len(list(tmp_path.glob("*.npy"))) == 3
    assert "frame_00000.png: exists already" in refusal(2, *f"{words} 2".split())
    (tmp_path / "own.png").touch()
    succeed(f"{words} 2 --overwrite")
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == ["frame_00000.png", "frame_00001.png", "own.png"]


def test_a_video_is_written(here, tmp_path, refusal):
    pytest.importorskip("imageio_ffmpeg", reason="needs clgs[video]")
    clip = tmp_path / "clip.mp4"
    succeed(f"render splats.ply --path orbit --frames 4 --size 40x30 --fps 10 -o {clip}")
    assert clip.stat().st_size > 500
    words = f"render splats.ply --path orbit --size 40x30 -o {clip}"
    assert "exists already" in refusal(2, *words.split())


def test_splats_are_scored_and_over_another_background_differ(here, tmp_path):
    scores = {}
    for scene in ("splats.ply", "splats.clgs"):
        for background in ("black", "white"):
            text = succeed(f"eval {scene} --data data --background {background} --json")
            scores[scene, background] = json.loads(text)
    first = scores["splats.ply", "black"]
    assert first["gaussians"] == 300
    assert "anchors" not in first
    assert first["bytes"] == (here / "splats.ply").stat().st_size
    assert first["psnr"] != scores["splats.ply", "white"]["psnr"]
    # the steps of packing move a color by 1/64 and less
    assert abs(first["psnr"] - scores["splats.clgs", "black"]["psnr"]) < 0.5
    table = tmp_path / "t.csv"
    succeed(f"eval splats.clgs --data data --csv {table}")
    assert table.read_text().splitlines()[1].endswith(",300")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("render s.npz -o x", 2, "nothing to render: name the photos with --data, or a path"),
        ("render s.npz --path circle -o x", 2, "--path circle: is not orbit, spiral"),
        ("render s.npz --path interpolate -o x", 2, "--path interpolate: goes through photos"),
        ("render s.npz --data data -o x.mp4", 2, "x.mp4: a video is a clip; give --path"),
        ("render s.npz --data data --frames 3 -o x", 2, "--frames: belongs to a clip"),
        ("render s.npz --data data --save-path p.json -o x", 2, "--save-path: belongs to a clip"),
        ("render s.npz --path orbit --size 40 -o x", 2, "40 is not WIDTHxHEIGHT"),
        ("render s.npz --path orbit --size 0x9 -o x", 2, "0x9: sides are 1 to 16384"),
        ("render s.npz --path orbit --size 100000x100000 -o x", 2, "100000x100000: sides are 1"),
        ("render s.npz --path orbit --up -w -o x", 2, "--up: expected one argument"),
        ("render s.npz --path orbit --fps 0 -o x", 2, "0 is not a number from 0.1"),
        ("render s.npz --path orbit -o x.webm", 2, "x.webm: a video is an .mp4 file"),
        ("render s.npz --path orbit --size 9x8 -o x.mp4", 2, "--size 9x8: a video needs even"),
        ("render s.npz --path no.json -o x", 3, "no.json: no such file"),
        ("render s.npz --path orbit --up z --data data -o x", 2, "--up: cameras say what is up"),
        ("render s.npz --path orbit --split test -o x", 2, "--split: a clip shows no views"),
        ("render s.npz --path orbit --downscale 2 -o x", 2, "--downscale: no photos give the"),
        ("render s.npz --path p.json --max-size 90 -o x", 2, "--max-size: no photos give the"),
        ("render s.npz --path orbit --save-path p.txt -o x", 2, "p.txt: a camera path is a .json"),
        ("render s.npz --path orbit --depth --opacity -o x", 2, "not allowed with"),
        ("render s.npz --path orbit -o x.png", 2, "x.png: pictures go into a folder; name one"),
        ("render s.npz --data data -o x.JPG", 2, "x.JPG: pictures go into a folder; name one"),
        ("render s.npz --path orbit -o run", 2, "run: holds a run; name another folder"),
        ("render data/no.ply --path orbit -o x", 3, "no.ply: no such file"),
        ("render s.npz --path interpolate --up z --data data -o x", 2, "--up: cameras say what"),
        ("render splats.ply --path orbit --smallest-anchor 2 -o x", 2, "--smallest-anchor: splats"),
        ("eval splats.ply --data data --smallest-anchor 2", 2, "--smallest-anchor: splats.ply"),
        ("view splats.ply --smallest-anchor 2", 2, "--smallest-anchor: splats.ply holds splats"),
        ("view s.npz --box -inf,0,0,1,1,1", 2, "--box: a box without an end cannot be shown"),
        ("view s.npz --box 0,0,0,1,-1,1", 2, "box: y from 0 to -1 is empty; lower end first"),
        ("view s.npz --max-size 90", 2, "--max-size: no photos are known without --data"),
        ("view s.npz --masks object", 2, "--masks: no photos are known without --data"),
        ("eval splats.ply --hashes s.npz", 2, "splats.ply: holds splats; --hashes are those of"),
    ],
)
def test_what_cannot_be_done_is_said(here, words, code, said):
    done = clgs(*words.split())
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1 or "up is taken" in done.stderr
    assert not (here / "x").exists()
    assert not list(here.glob("*.mp4"))
