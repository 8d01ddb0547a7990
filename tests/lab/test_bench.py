"""``clgs bench``: tiny scenes, and remedies that the benchmark itself has."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from clgs.cli.main import main
from clgs.codec.scene_encoder import encode
from clgs.errors import NoRoomError
from clgs.lab.bench import scaling
from clgs.lab.bench.codec import file_subjects
from clgs.lab.bench.scaling import Memory, Run, Scaling, growth
from clgs.lab.commands import bench
from tests.codec.scenes import random_scene


def test_a_single_gaussian_is_enough(tmp_path):
    file = tmp_path / "times.json"
    tiny = ["--gaussians", "1", "--size", "16", "--repeats", "1", "--json", str(file)]
    assert main(["bench", "step", *tiny]) == 0
    times = json.loads(file.read_text())
    assert times["anchors"] == 1
    assert 30 < times["launches"] < 70  # of either form
    kernels = times["kernels"]
    assert {"adam_step", "blend_backward", "mlp_backward", "project_forward"} <= set(kernels)
    assert all(milliseconds > 0 for milliseconds in kernels.values())
    assert times["host"] > 0
    assert times["waits"] >= 0


def test_width_and_height_are_given_apart(output_of):
    tiny = ["--gaussians", "300", "--repeats", "1"]
    assert "48x16 px" in " ".join(output_of("bench", "step", *tiny, "--size", "48x16").split())


NO_SIZE = " is not WIDTHxHEIGHT, such as 1920x1080"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        *((["step", "--size", size], f"--size: {size}{NO_SIZE}") for size in ("8x", "x", "8x8x8")),
        (["step", "--size", "9" * 30], "--size: "),
        (["step", "--size", "20000x5"], "--size: "),
        (["step", "--gaussians", "3000000000"], "--gaussians: "),
        (["ops", "--elements", "3000000000"], "--elements: "),
        (["scaling", "--sizes", "40", "16385"], "--sizes: "),
    ],
)
def test_no_sizes_and_more_than_a_device_can_hold_are_refused(refusal, arguments, said):
    assert refusal(2, "bench", *arguments).startswith(said)


@pytest.mark.parametrize("kind", ["scaling", "accuracy"])
@pytest.mark.parametrize(("plot", "said"), [("x.svg", "same file"), ("x.png", "are SVG")])
def test_figures_need_a_file_of_their_own(tmp_path, monkeypatch, refusal, kind, plot, said):
    monkeypatch.chdir(tmp_path)
    assert said in refusal(2, "bench", kind, "-o", "x.svg", "--plot", f"./{plot}")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", bench.KINDS)
@pytest.mark.parametrize(
    ("error", "code"), [(MemoryError("1 TiB"), 1), (NoRoomError("no room for 1 TiB"), 4)]
)
def test_remedies_are_options_of_the_benchmark(monkeypatch, refusal, output_of, kind, error, code):
    def fail():  # its arguments are read: the command gives it those that it names
        raise error

    monkeypatch.setattr(f"clgs.lab.bench.{kind}.run", fail)
    said = refusal(code, "bench", kind)
    options = [word.strip(",;.\n") for word in said.split() if word.startswith("--")]
    assert options
    assert set(options) <= set(output_of("bench", kind, "--help").replace(",", " ").split())


def test_one_size_has_no_exponent(capsys):
    assert growth([(5.0, 1.0)]).exponent is None
    assert growth([(5.0, 1.0), (5.0, 2.0)]).exponent is None
    run = Run(1000, 2000, 3000, 4.0, 5000)
    one = growth([(1000, 4.0)])
    scaling.show(Scaling([run], [run], [run], one, one, Memory(None, 2.0, None)))
    said = capsys.readouterr().out
    assert "nan" not in said
    assert "time ~ count^- " in said
    assert "- bytes per Gaussian and - per pixel" in said
    assert "2 per intersection" in said


@pytest.fixture
def codec_file(tmp_path):
    values = np.random.default_rng(1).integers(-3, 4, (50, 4), dtype=np.int16)
    np.savez(tmp_path / "iid_feat.npz", values=values)
    np.savez(tmp_path / "cloud.npz", positions=np.argwhere(np.ones((4, 3, 2), bool)))
    return tmp_path


def test_codec_measures_every_level_of_files(codec_file, capsys):
    target = codec_file / "figures.json"
    assert main(["bench", "codec", str(codec_file), "--repeats", "1", "--json", str(target)]) == 0
    cloud, rows = json.loads(target.read_text())["subjects"]
    names = [coder["coder"] for coder in rows["coders"]]
    assert names[:4] == ["fast", "default", "max", "paper"]
    assert "xz -9" in names
    assert rows["baseline"] == 588078
    assert rows["coders"][0]["ratio"] == rows["coders"][0]["bytes"] / 588078
    assert cloud["baseline"] is None
    assert cloud["symbols"] == 24
    assert "published" in capsys.readouterr().out


@pytest.mark.slow
def test_codec_measures_a_seeded_scene_and_its_file(tmp_path):
    target = tmp_path / "figures.json"
    tiny = ["--anchors", "300", "--levels-only", "--repeats", "1", "--json", str(target)]
    assert main(["bench", "codec", *tiny]) == 0
    subjects = json.loads(target.read_text())["subjects"]
    assert [s["name"] for s in subjects] == [
        f"seeded {part}" for part in ("offset", "feature", "scaling", "position", "file")
    ]
    assert all(coder["bytes"] > 0 for s in subjects for coder in s["coders"])


def test_the_case_of_suffixes_does_not_matter(tmp_path):
    scene = random_scene(np.random.default_rng(3), 5)
    (tmp_path / "scene.CLGS").write_bytes(encode(scene))
    np.savez(tmp_path / "rows", values=np.arange(6).reshape(2, 3))
    (tmp_path / "rows.npz").rename(tmp_path / "rows.NPZ")
    names = [subject.name for subject in file_subjects([tmp_path])]
    assert names[0] == "rows"
    assert names[1:] == [s.name for s in file_subjects([tmp_path / "scene.CLGS"])]
    assert len(names) == 6


def test_codec_names_what_it_cannot_read(tmp_path, refusal):
    (tmp_path / "bad.npz").write_bytes(b"no archive")
    (tmp_path / "bad.clgs").write_bytes(b"no scene")
    np.savez(tmp_path / "wide.npz", values=np.array([[2**31]]))
    bad = [tmp_path / name for name in ("bad.npz", "none.npz", "empty", "bad.clgs", "wide.npz")]
    for data in bad:
        (tmp_path / "empty").mkdir(exist_ok=True)
        assert str(data) in refusal(3, "bench", "codec", data)


def test_absent_compressors_are_named_and_left_out(codec_file, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "brotli", None)
    assert main(["bench", "codec", str(codec_file), "--repeats", "1"]) == 0
    said = capsys.readouterr()
    assert said.err.count("brotli is not installed") == 1
    assert "brotli 11" not in said.out
