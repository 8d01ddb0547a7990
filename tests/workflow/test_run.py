"""`clgs run` on a tiny data set: plan, stages, resuming, refusals."""

from __future__ import annotations

import html
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from clgs.cli import main as cli
from clgs.errors import DataError
from clgs.train.config import from_toml
from clgs.train.run.run_folder import FolderLock
from clgs.workflow.runs import clocks, stages
from clgs.workflow.runs.plan import Photos
from clgs.workflow.runs.record import RunRecord, find_input
from clgs.workflow.runs.run import run
from tests.data.folders import move_cameras
from tests.small_scene import write_scene
from tests.terminal import as_from_a_terminal
from tests.workflow.test_run_time import once

OFFSETS = ("--set", "learning_rates.offset=0.01,0.0001")
TRAINED = ("--lambda=0.03", "--max-anchors", "9000", "--set", "log_interval=7", *OFFSETS)


@pytest.fixture(scope="module", autouse=True)
def _quick():
    """Training starts from few points, and the speed of its steps is measured once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("clgs.data.points.HULL_POINTS", 4000)
        patch.setattr(stages, "speed_on", once(clocks.speed_on))
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("run") / "data", train=6, test=2)


def words(data, out, *more):
    return ["run", str(data), "-o", str(out), "--steps", "30", *TRAINED, *map(str, more)]


@pytest.fixture(scope="module")
def finished(data, tmp_path_factory):
    """The output folder of a run."""
    out = tmp_path_factory.mktemp("run") / "out"
    clip = ["--clip", "spiral", "--clip-time", "1s", "--clip-size", "48x32", "--name", "<Hut>"]
    assert cli.main(words(data, out, *clip)) == 0
    return out


@pytest.mark.skipif(os.name == "nt", reason="folders cannot be locked on Windows")
def test_a_folder_in_use_is_left_alone(data, tmp_path, refusal):
    out = tmp_path / "out"
    out.mkdir()
    lock = FolderLock(out)
    for more in ([], ["--overwrite"], ["--resume"]):
        assert "another process works in it" in refusal(3, *words(data, out, *more))
    assert not list(out.iterdir())
    lock.release()


@pytest.mark.slow
def test_plan_alone_writes_nothing(data, tmp_path, output_of):
    printed = output_of(*words(data, tmp_path / "out", "--plan"))
    assert "8 of 40 x 40 pixels" in printed
    assert "30 steps on photos at most 40 wide" in printed
    assert not (tmp_path / "out").exists()


def test_everything_is_there(finished, output_of):
    for name in ("run", "scene.clgs", "scores.json", "report.html", "plan.json", "scene.ply"):
        assert (finished / name).exists(), name
    scores = json.loads((finished / "scores.json").read_text())
    assert scores["split"] == "test"
    assert scores["bytes"] == (finished / "scene.clgs").stat().st_size
    page = (finished / "report.html").read_text()
    assert page.count("data:image/jpeg") == 2 * 3
    assert "<title>&lt;Hut&gt;</title>" in page
    order = [page.index(part) for part in ("data:image", "PSNR, held out", "Bytes by section")]
    assert order == sorted(order)
    assert "<title>&lt;Hut&gt;</title>" in (finished / "scene.html").read_text()
    assert "--size-lambda" not in page
    command = re.findall(r"clgs run [^<\n]*", page)[-1]
    assert "--lambda 0.03" in command
    assert "--set log_interval=7 --set learning_rates.offset=0.01,0.0001" in command
    command = html.unescape(command)
    assert "--name '<Hut>' --clip spiral --clip-time 1s --clip-size 48x32" in command
    again = output_of(*shlex.split(command)[1:], "--overwrite", "--plan")
    assert "30 steps on photos at most 40 wide" in again
    config = from_toml((finished / "run" / "config.toml").read_text())
    assert (config.size_lambda, config.max_anchors, config.log_interval) == (0.03, 9000, 7)
    clip = json.loads((finished / "plan.json").read_text())["plan"]["clip"]
    assert (clip["path"], clip["width"], clip["frames"]) == ("spiral", 48, 30)
    for name in ("scene.html", "scene.ply", "clip.mp4"):
        assert (finished / name).exists() == (f'href="{name}"' in page)


def test_run_is_neither_replaced_nor_continued_unasked(data, finished, refusal):
    assert "--resume" in refusal(2, *words(data, finished))


def test_finished_run_is_left_as_it_is(data, finished, output_of):
    def files():
        paths = (path for path in finished.rglob("*") if path.is_file())
        return {path: path.stat().st_mtime_ns for path in paths}

    before, page = files(), (finished / "report.html").read_text()
    assert "[page] is there" in output_of(*words(data, finished, "--resume"))
    changed = {path.name for path, when in files().items() if before.get(path) != when}
    assert changed == {"report.html"}
    assert (finished / "report.html").read_text() == page


@pytest.mark.slow
def test_what_is_damaged_or_gone_is_made_again(data, finished, capsys):
    files = [finished / name for name in ("scene.clgs", "scene.ply", "run/scene.clgs")]
    whole = [file.read_bytes() for file in files]
    for file in files[:2]:
        file.write_bytes(file.read_bytes()[:500])
    files[2].unlink()
    assert cli.main(words(data, finished, "--resume")) == 0
    assert [file.read_bytes() for file in files] == whole
    assert "[page] is there" in capsys.readouterr().out


def test_a_run_without_its_plan_is_refused(data, finished, refusal):
    plan = finished / "plan.json"
    text = plan.read_text()
    plan.unlink()
    said = refusal(2, *words(data, finished, "--resume"))
    assert "holds a run, but not its plan.json; finish" in said
    plan.write_text(text)


@pytest.mark.slow
def test_what_is_lacking_is_made_again_and_its_time_is_added(data, finished, capsys):
    before = json.loads((finished / "plan.json").read_text())["seconds"]
    splats = (finished / "scene.ply").read_bytes()
    (finished / "scene.ply").unlink()
    assert cli.main(words(data, finished, "--resume")) == 0
    assert (finished / "scene.ply").read_bytes() == splats
    after = json.loads((finished / "plan.json").read_text())["seconds"]
    assert {name for name in after if after[name] != before[name]} == {"Gaussians"}
    assert after["Gaussians"] > before["Gaussians"]


def test_a_clip_without_a_named_path_is_an_orbit(data, finished, tmp_path, output_of):
    pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    out = tmp_path / "out"
    shutil.copytree(finished, out)
    (out / "clip.mp4").unlink()
    plan = json.loads((out / "plan.json").read_text())
    plan["plan"]["clip"]["path"] = ""
    (out / "plan.json").write_text(json.dumps(plan))
    shown = output_of(*words(data, out, "--resume"))
    assert "--path orbit --frames 30 --fps 30 --size 48x32" in shown
    assert (out / "clip.mp4").stat().st_size > 1000


@pytest.mark.parametrize("name", ["", "scene.clgs", "scene.ply"])
def test_what_a_run_made_knows_its_photos(finished, name, output_of):
    """The folder as a whole is as good as the folder ``run`` in it."""
    scores = json.loads(output_of("eval", finished / name, "--json"))
    psnr = json.loads((finished / "scores.json").read_text())["psnr"]
    assert scores["psnr"] == pytest.approx(psnr, abs=1.5 if name == "scene.ply" else 0)


@pytest.mark.slow
def test_the_folder_of_a_run_is_written_as_its_scene(finished, tmp_path):
    assert cli.main(["encode", str(finished), "-o", str(tmp_path / "x.clgs")]) == 0
    assert (tmp_path / "x.clgs").read_bytes() == (finished / "scene.clgs").read_bytes()
    for name in ("x.html", "x.glb"):
        assert cli.main(["export", str(finished), "-o", str(tmp_path / name)]) == 0
        assert (tmp_path / name).stat().st_size > 0


@pytest.mark.parametrize("command", ["eval", "export"])
def test_what_is_not_finished_has_to_go_on(tmp_path, command, refusal):
    out = tmp_path / "out"
    (out / "run").mkdir(parents=True)
    (out / "plan.json").write_text("{}")
    (out / "run" / "config.toml").touch()
    for folder in (out, out / "run"):
        more = ["--data", str(tmp_path)] if command == "eval" else ["-o", str(tmp_path / "x.html")]
        assert "let `clgs run` finish (--resume)" in refusal(3, command, folder, *more)


def test_run_goes_on_with_its_own_input_and_options_alone(data, finished, tmp_path, refusal):
    other = write_scene(tmp_path / "other", train=3, test=1)
    assert f"is a run of {data}" in refusal(2, *words(other, finished, "--resume"))
    assert "--steps: the run in" in refusal(2, *words(data, finished, "--resume", "--steps", "31"))
    said = refusal(2, *words(data, finished, "--resume"), "--target-size", "90k")
    assert "give one of the two" in said
    said = refusal(2, *words(data, finished, "--resume"), "--lambda", "0.7")
    assert "--lambda: the run in" in said
    said = refusal(2, *words(data, finished, "--resume"), "--background", "white")
    assert "has its default; leave it out" in said
    assert "--steps 30 --max-size 40" in (finished / "report.html").read_text()


def test_damaged_photos_do_not_end_the_plan(tmp_path, refusal):
    photos, out = tmp_path / "photos", tmp_path / "out"
    photos.mkdir()
    for name, color in (("b", "red"), ("c", "blue"), ("d", "green")):
        Image.new("RGB", (64, 48), color).save(photos / f"{name}.png")
    (photos / "a.png").write_bytes((photos / "b.png").read_bytes()[:20])
    assert find_input(photos).photos == Photos(3, 64, 48)
    (photos / "d.png").write_bytes(b"")
    said = refusal(3, *words(photos, out))
    assert "2 photos that can be read" in said
    assert "a.png" in said
    assert "d.png" in said
    assert not out.exists()


def test_run_goes_on_with_its_own_photos_alone(tmp_path, refusal):
    photos, out = tmp_path / "photos", tmp_path / "out"
    photos.mkdir()
    for name in ("red", "green", "blue"):
        Image.new("RGB", (64, 64), name).save(photos / f"{name}.png")
    (out / "data").mkdir(parents=True)
    begun = RunRecord(str(photos.resolve()), 2, "", 600.0)
    begun.write(out)
    said = refusal(2, *words(photos, out, "--resume"))
    assert f"has 3 photos, and the run in {out} began with 2" in said
    replace(begun, photos=3).write(out)  # as many, but others
    said = refusal(2, *words(photos, out, "--resume"))
    assert f"holds other photos than the run in {out} began with" in said
    replace(begun, photos=3, digest=find_input(photos).digest).write(out)
    assert cli.main(words(photos, out, "--resume", "--device", "nonexistent")) == 4
    begun.write(out)
    (out / "data").rmdir()  # no poses yet: those of the third are found with the others
    assert cli.main(words(photos, out, "--resume", "--device", "nonexistent")) == 4


def test_run_that_was_interrupted_before_training_goes_on(data, tmp_path, refusal):
    out = tmp_path / "out"
    out.mkdir()
    RunRecord(str(data.resolve()), 4, "", 600.0).write(out)
    assert cli.main(words(data, out, "--resume", "--device", "nonexistent")) == 4
    (out / "plan.json").write_text("{}")
    assert "is damaged" in refusal(3, *words(data, out, "--resume"))


@pytest.mark.slow
def test_what_follows_from_the_plan_is_kept(data, tmp_path, output_of):
    """A run that began coarse goes on so; the command that repeats it names what may be chosen."""
    out = tmp_path / "out"
    out.mkdir()
    settings = {"steps": 30, "max_size": 40, "seed": 0, "coarse_to_fine": True}
    RunRecord(str(data), 8, "", 600.0, settings).write(out)
    assert "--coarse-to-fine" in output_of("run", data, "-o", out, "--resume")
    assert "coarse_to_fine = true" in (out / "run" / "config.toml").read_text()
    page = (out / "report.html").read_text()
    assert "--steps 30 --max-size 40 --seed 0" in page
    assert "--coarse-to-fine" not in page


def test_output_of_a_run_is_no_input(finished, tmp_path, refusal):
    assert "was made by clgs run" in refusal(3, *words(finished, tmp_path / "out"))


def test_scores_need_the_photos_of_the_scene(data, finished, tmp_path, refusal):
    assert cli.main(["eval", str(finished / "run")]) == 0
    wrong = write_scene(tmp_path / "wrong", train=3, test=1)
    for path in wrong.glob("transforms_*.json"):
        move_cameras(path, lambda centre: centre + np.array([40.0, 0.0, 0.0]))
    said = refusal(3, "eval", finished / "run", "--data", wrong)
    assert "these photos show another scene" in said
    further = ["train", str(wrong), "--from", str(finished / "run"), "-o", str(tmp_path / "new")]
    assert "these photos show another scene" in refusal(3, *further)
    further[1:2] = [str(data), "--box=50,50,50,51,51,51"]
    assert "holds none of the anchors of" in refusal(2, *further)
    assert not (tmp_path / "new").exists()


def test_foreign_folder_is_refused(data, tmp_path, refusal):
    (tmp_path / "mine.txt").touch()
    assert "holds other files" in refusal(2, *words(data, tmp_path, "--overwrite"))


def test_nothing_to_go_on_with_is_named(data, tmp_path, capsys):
    assert cli.main(words(data, tmp_path / "new", "--resume", "--device", "nonexistent")) == 4
    assert "new holds no run yet; one begins" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["missing", "empty"])
def test_nothing_to_train_on_is_named(tmp_path, refusal, name):
    (tmp_path / "empty").mkdir()
    assert name in refusal(3, *words(tmp_path / name, tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--set", "downscale=2"], "downscale: the plan reduces photos to a width"),
        (["--set", "steps=2"], "steps: the plan decides it; give --steps"),
        (["--set", "nonsense=2"], "nonsense: no such setting"),
        (["--set", "voxel=-2"], "voxel: -2 is out of range"),
        (["--resume", "--overwrite"], "give one"),
    ],
)
def test_settings_of_the_plan_and_a_contradiction_are_refused(data, tmp_path, more, said, refusal):
    assert said in refusal(2, *words(data, tmp_path / "out", *more))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_failing_stage_ends_the_run_and_passes_its_exit_code_on(
    data, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(stages, "train", Mock(side_effect=DataError("the photos are gone")))
    assert cli.main(words(data, tmp_path / "out")) == 3
    said = capsys.readouterr()
    assert "[train] clgs train" in said.out
    assert said.err.splitlines()[-2:] == [
        "clgs: error: the photos are gone",
        "clgs: error: train failed; mend that and repeat the command with --resume",
    ]
    assert set(json.loads((tmp_path / "out" / "plan.json").read_text())["seconds"]) == {
        "plan",
        "train",
    }


@pytest.mark.slow
def test_a_failing_export_does_not_end_the_run(data, tmp_path, monkeypatch, capsys):
    def fail(source, output, **_):
        raise DataError(f"no {output.name}")

    monkeypatch.setattr(stages, "export", fail)
    done = run(data, tmp_path / "out", steps=30)
    assert {name: str(error) for name, error in done.failures.items()} == {
        "page": "no scene.html",
        "Gaussians": "no scene.ply",
    }
    assert done.scores["views"] == 2
    assert (tmp_path / "out" / "report.html").is_file()
    assert cli.main(["run", str(data), "-o", str(tmp_path / "out"), "--resume"]) == 3
    assert "clgs: error: no scene.html\n" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("instant", ["[train]", ""], ids=["training", "plan"])
def test_warning_and_interruption_are_shown_once(tmp_path, instant):
    data = write_scene(tmp_path / "data", train=6, test=2)
    next((data / "train").iterdir()).unlink()
    command = [sys.executable, "-m", "clgs", "run", str(data), "-o", str(tmp_path / "out")]
    with (
        (tmp_path / "errors").open("w") as errors,
        subprocess.Popen(
            [*command, "--steps", "1000000"],
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            preexec_fn=as_from_a_terminal,
        ) as process,
    ):
        for line in process.stdout:
            if line.startswith(instant):
                break
        process.send_signal(signal.SIGINT)
        assert process.wait() == 130
    said = (tmp_path / "errors").read_text()
    assert said.count("1 of 8 photos are missing") == 1
    assert said.count("interrupted") == 1
    assert "repeat the command with --resume" in said
