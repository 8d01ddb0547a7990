"""The commands, as a user runs them, on a tiny scene."""

import io
import json
import subprocess
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from clgs.scene.anchors import take
from clgs.scene.storage import load_scene, save_scene
from tests.cli.calls import exit_code
from tests.small_scene import write_scene
from tests.terminal import python

STEPS = 220
"""Just enough for one change of the anchors, at step 100, and for quantisation."""


FEW_POINTS = """
import sys
from clgs.cli import main
from clgs.data import points
points.HULL_POINTS = 4000
sys.exit(main.main())
"""
"""The command, but training starts from few points: quick, and learns as well."""


def clgs(*arguments):
    """The command in this process, which starts sooner."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.MonkeyPatch.context() as patch:
        patch.setattr("clgs.data.points.HULL_POINTS", 4000)
        code = exit_code([str(one) for one in arguments])
    command = ["clgs", *map(str, arguments)]
    return subprocess.CompletedProcess(command, code, out.getvalue(), err.getvalue())


def succeed(*arguments, **environment):
    """What the command prints; with variables in a process of its own."""
    program = ("-c", FEW_POINTS)
    done = python(*program, *arguments, **environment) if environment else clgs(*arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def run(data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    succeed("train", data, "-o", folder, "--steps", STEPS, POCL_MAX_PTHREAD_COUNT="2")
    return folder


def test_run_folder_is_complete(run):
    files = ["config.toml", "progress.csv", "scene.clgs", "results.json", "per_view.json"]
    for name in [*files, "hashes.json", "preview.png"]:
        assert (run / name).stat().st_size > 0, name
    pictures = sorted(path.name for path in (run / "test" / "ours_220" / "renders").iterdir())
    assert pictures == sorted(path.name for path in (run / "test" / "ours_220" / "gt").iterdir())
    assert len(pictures) == 3
    results = json.loads((run / "results.json").read_text())
    assert results["psnr"] > 15
    assert results["bytes"] == (run / "scene.clgs").stat().st_size
    assert set(results["switch_psnr"]) >= {"psnr before quantisation", "psnr just after the switch"}


def test_encode_decode_eval_from_the_file_alone(run, data, tmp_path):
    file = tmp_path / "scene.clgs"
    succeed("encode", run, "-o", file)
    assert file.read_bytes() == (run / "scene.clgs").read_bytes()
    assert json.loads(succeed("info", file, "--json"))["sections"]["MLPS"] < 15_000
    floats = tmp_path / "floats.clgs"
    succeed("encode", run, "--mlp", "float32", "-o", floats)
    assert floats.stat().st_size > file.stat().st_size
    succeed("decode", file, "-o", tmp_path / "scene.npz")
    with np.load(tmp_path / "scene.npz") as mine, np.load(run / "scene.npz") as theirs:
        assert sorted(mine.files) == sorted(theirs.files)
        assert all(np.array_equal(mine[name], theirs[name]) for name in mine.files)
    assert "all equal" in succeed("eval", file, "--hashes", run / "hashes.json")
    succeed("eval", file, "--data", data, "--json", tmp_path / "scores.json")
    scores = json.loads((tmp_path / "scores.json").read_text())
    results = json.loads((run / "results.json").read_text())
    assert scores["psnr"] == results["psnr"]
    assert scores["bytes"] == results["bytes"]
    assert "clgs" in scores["protocol"]
    succeed("render", file, "--data", data, "--split", "test", "-o", tmp_path / "pictures")
    for path in (run / "test" / "ours_220" / "renders").iterdir():
        assert (tmp_path / "pictures" / path.name).read_bytes() == path.read_bytes()
    assert "ANCH" in succeed("info", file)


def test_hashes_tell_a_difference(run, tmp_path):
    hashes = json.loads((run / "hashes.json").read_text())
    hashes["renders"][1] = "0" * 64
    (tmp_path / "hashes.json").write_text(json.dumps(hashes))
    done = clgs("eval", run, "--hashes", tmp_path / "hashes.json")
    assert done.returncode == 1
    assert "render 1" in done.stdout


@pytest.mark.slow
def test_accuracy_is_that_of_the_run_unless_another_is_named(data, tmp_path):
    run = tmp_path / "run"
    said = succeed("train", data, "-o", run, "--steps", 20, "--accuracy", "preview", "--profile")
    assert "blend backward" in said
    profile = json.loads((run / "profile.json").read_text())
    assert {stage["stage"] for stage in profile["stages"]} >= {"cull", "adam", "loss backward"}
    assert 'accuracy = "preview"' in (run / "config.toml").read_text()
    assert json.loads((run / "hashes.json").read_text())["accuracy"] == "preview"
    assert "all equal" in succeed("eval", run, "--hashes", run / "hashes.json")
    results = json.loads((run / "results.json").read_text())
    scores = json.loads(succeed("eval", run, "--data", data, "--json"))
    assert (scores["accuracy"], scores["psnr"]) == ("preview", results["psnr"])
    other = json.loads(succeed("eval", run, "--data", data, "--accuracy", "parity", "--json"))
    assert other["accuracy"] == "parity"
    assert other["psnr"] != scores["psnr"]


@pytest.mark.slow
def test_a_memory_budget_changes_nothing(data, run):
    """Two MiB; the pictures, and so the scores: all but the time."""
    whole, grouped = (
        json.loads(succeed("eval", run, "--data", data, "--json", *budget))
        for budget in ((), ("--max-memory", 2))
    )
    assert whole.pop("render_seconds") > 0
    assert grouped.pop("render_seconds") > 0
    assert grouped == whole


@pytest.mark.slow
def test_same_command_same_file_for_any_number_of_threads(data, run, tmp_path):
    """``run`` was trained on two."""
    folder = tmp_path / "run"
    succeed("train", data, "-o", folder, "--steps", STEPS, POCL_MAX_PTHREAD_COUNT="1")
    assert (folder / "scene.clgs").read_bytes() == (run / "scene.clgs").read_bytes()


def one_line(done, code, *words):
    assert done.returncode == code, (done.returncode, done.stderr)
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert all(word in lines[0] for word in words), lines[0]


def test_bad_input_is_one_line(run, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.clgs").write_text("no scene at all")
    whole = (run / "scene.clgs").read_bytes()
    (tmp_path / "cut.clgs").write_bytes(whole[: len(whole) // 2])
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 4
    (tmp_path / "flipped.clgs").write_bytes(flipped)
    one_line(clgs("train", tmp_path / "missing", "-o", tmp_path / "r"), 3, "missing")
    one_line(clgs("train", tmp_path / "empty", "-o", tmp_path / "r"), 3, "empty")
    for name in ("text", "cut", "flipped"):
        file, output = tmp_path / f"{name}.clgs", tmp_path / f"{name}.npz"
        one_line(clgs("decode", file, "-o", output), 3, "clgs: error:")
        assert not output.exists()
        one_line(clgs("info", file), 3, "clgs: error:")
        one_line(clgs("eval", file, "--hashes", run / "hashes.json"), 3, "clgs: error:")
    for options in ([], ["--target-psnr", 30], ["--layers", 2]):
        words = "encode", tmp_path / "empty", "-o", tmp_path / "x.clgs"
        one_line(clgs(*words, *options), 3, "scene.npz")
    assert not (tmp_path / "x.clgs").exists()
    assert not (tmp_path / "r" / "config.toml").exists()


def test_run_folder_is_not_overwritten(run, data):
    one_line(clgs("train", data, "-o", run, "--steps", 5), 2, "--resume", "--overwrite")


def test_an_interrupted_run_says_how_to_go_on(data, tmp_path, monkeypatch):
    monkeypatch.setattr("clgs.train.run.session.Session.run", Mock(side_effect=KeyboardInterrupt))
    done = clgs("train", data, "-o", tmp_path / "run", "--steps", 5)
    one_line(done, 130, "clgs: interrupted; repeat the command with --resume to go on")


@pytest.mark.slow
def test_no_device_is_exit_code_4(run, tmp_path):
    none = {"OCL_ICD_VENDORS": str(tmp_path), "PYOPENCL_CTX": "no such device"}
    one_line(python("-m", "clgs", "selftest", **none), 4, "device")


@pytest.mark.slow
def test_bench():
    assert "blend backward" in succeed("bench", "step", "--gaussians", 2000, "--size", 64)
    small = ("--gaussians", 2000, "--size", 64, "--elements", 5000, "--repeats", 2)
    assert "of limit" in succeed("bench", "ops", *small)


@pytest.mark.slow
def test_bench_accuracy(run, data, tmp_path, monkeypatch):
    monkeypatch.setenv("CLGS_CACHE", str(tmp_path))
    monkeypatch.setattr("clgs.lab.bench.accuracy_points.CUTS", (255, 1024, 16384))
    figures, plot = tmp_path / "accuracy.json", tmp_path / "accuracy.svg"
    whole = load_scene(run / "scene.npz")
    save_scene(tmp_path / "few.npz", replace(whole, anchors=take(whole.anchors, slice(300))))
    scenes = ("--scenes", "tiny", "--scene", tmp_path / "few.npz", "--data", data)
    output = ("--sweeps", "alpha cut", "--repeats", 2, "-o", figures, "--plot", plot)
    printed = succeed("bench", "accuracy", *scenes, *output)
    assert "fast against parity" in printed
    scenes = json.loads(figures.read_text())["scenes"]
    assert len(scenes) == 2
    for scene in scenes:
        points = {(one["sweep"], one["label"]): one for one in scene["points"]}
        cuts = [points["alpha cut", f"1/{part}"] for part in (255, 1024, 16384)]
        # finer is nearer: 3.5 to 4 times for every quarter of the cut
        assert cuts[0]["image"]["p999"] > 2 * cuts[1]["image"]["p999"]
        assert cuts[1]["image"]["p999"] > 8 * cuts[2]["image"]["p999"] > 0
        worst = [max(one["gradient"]["relative_l2"].values()) for one in cuts]
        assert worst[0] > worst[1] > worst[2] > 0
    assert "<svg" in plot.read_text()
