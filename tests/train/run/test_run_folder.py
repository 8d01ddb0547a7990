"""Runs that are over stay as they are, and nothing is written before it is known to work."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from clgs.cli import main as cli
from clgs.data.dataset import load_dataset
from clgs.data.view import StoredPhoto
from clgs.errors import BudgetError, DataError
from clgs.render import tile_groups
from clgs.train.config import preset
from clgs.train.run.load import with_points
from clgs.train.run.run_folder import FolderLock
from clgs.train.run.session import train_scene
from tests.small_scene import write_scene

CONFIG = replace(preset("default").scaled(10), voxel=0.05)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("balls"), train=4, test=3)


@pytest.fixture(scope="module")
def dataset(data):
    whole = with_points(load_dataset(data))
    return replace(whole, points=whole.points[::25])


@pytest.fixture(scope="module")
def finished(dataset, open_device, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    return train_scene(dataset, folder, CONFIG, device=open_device("cpu"))


@pytest.fixture
def huge_entries(monkeypatch):
    """Every tile entry takes a MiB."""
    monkeypatch.setattr(tile_groups, "BYTES_BY_ENTRY", 2**20)


def files(folder):
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.rglob("*.*")}


@pytest.mark.parametrize("max_memory", [0, 64])
def test_a_finished_run_is_read_and_left_alone(finished, dataset, open_device, max_memory):
    before = files(finished.folder)
    config = replace(CONFIG, max_memory=max_memory)
    device = open_device("cpu")
    again = train_scene(dataset, finished.folder, config, device=device, resume=True)
    assert files(finished.folder) == before
    assert again.bitstream == finished.bitstream
    assert again.summary["psnr"] == finished.summary["psnr"]


@pytest.mark.slow
def test_the_command_says_that_a_run_is_finished(data, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("clgs.data.points.HULL_POINTS", 3000)  # for speed
    command = ["train", str(data), "-o", str(tmp_path / "run"), "--steps", "3", "--resume"]
    assert cli.main(command) == 0
    before = files(tmp_path / "run")
    capsys.readouterr()
    assert cli.main(command) == 0
    assert "is finished already, after 3 steps; nothing is changed" in capsys.readouterr().out
    assert cli.main([*command, "--seed", "1"]) == 2
    assert "finished run with other settings or photos (--seed: 0 there, 1 here)" in (
        capsys.readouterr().err
    )
    assert cli.main([*command, "--steps", "4"]) == 2
    assert "(--steps: 3 there, 4 here); give the same" in capsys.readouterr().err
    assert files(tmp_path / "run") == before


@pytest.mark.slow
def test_a_run_that_was_killed_before_its_report_gets_it(data, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("clgs.data.points.HULL_POINTS", 3000)  # for speed
    command = ["train", str(data), "-o", str(tmp_path / "run"), "--steps", "3"]
    assert cli.main(command) == 0
    report = tmp_path / "run" / "report.html"
    whole = report.read_bytes()
    report.unlink()
    capsys.readouterr()
    assert cli.main([*command, "--resume"]) == 0
    assert "nothing is changed" not in capsys.readouterr().out
    assert report.read_bytes() == whole
    report.unlink()
    shutil.rmtree(tmp_path / "run" / "test")  # the pictures, which only the report needs
    assert cli.main([*command, "--resume"]) == 0
    shown = capsys.readouterr()
    assert "no report.html: " in shown.err
    assert "nothing is changed" in shown.out


@pytest.mark.slow
def test_another_data_set_is_refused_before_it_is_read(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("clgs.data.points.HULL_POINTS", 3000)  # for speed
    pair = tmp_path / "pair"
    data, run = write_scene(pair / "data", train=3, test=1), pair / "run"
    options = ["--steps", "3", "--resume"]
    assert cli.main(["train", str(data), "-o", str(run), *options]) == 0
    before = files(run)
    (tmp_path / "empty").mkdir()
    assert cli.main(["train", str(tmp_path / "empty"), "-o", str(run), *options]) == 2
    assert f"{run}: holds a run of {data}; name that" in capsys.readouterr().err
    assert files(run) == before
    copy = shutil.copytree(pair, tmp_path / "copy")  # both together, while the first is there
    assert cli.main(["train", str(copy / "data"), "-o", str(copy / "run"), *options]) == 0
    pair.rename(tmp_path / "moved")
    data, run = tmp_path / "moved" / "data", tmp_path / "moved" / "run"
    assert cli.main(["train", str(data), "-o", str(run), *options]) == 0
    assert capsys.readouterr().out.count("is finished already") == 2


def test_other_photos_are_noticed(finished, dataset, open_device):
    view = dataset.train[0]
    pixels = view.photo.pixels()
    negative = StoredPhoto.of(replace(pixels, color=255 - pixels.color))
    other = replace(dataset, train=[replace(view, photo=negative), *dataset.train[1:]])
    before = files(finished.folder)
    with pytest.raises(DataError, match="other settings or photos"):
        train_scene(other, finished.folder, CONFIG, device=open_device("cpu"), resume=True)
    assert files(finished.folder) == before


def cut(path):
    path.write_bytes(path.read_bytes()[:-7])


def flip(path):
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole)


def put(name, value):
    """A change of one field of a JSON file."""

    def change(path):
        path.write_text(json.dumps(json.loads(path.read_text()) | {name: value}))

    return change


@pytest.mark.parametrize(
    ("name", "damage", "reason"),
    [
        ("scene.clgs", Path.unlink, r"scene\.clgs"),
        ("scene.clgs", cut, r"scene\.clgs has \d+ bytes, not \d+"),
        ("scene.clgs", flip, ""),
        ("scene.npz", Path.unlink, r"scene\.npz"),
        ("scene.npz", cut, r"scene\.npz"),
        ("hashes.json", Path.unlink, r"hashes\.json"),
        ("hashes.json", put("scene", "0" * 64), r"scene\.clgs and hashes\.json differ"),
        ("results.json", cut, ""),
        ("results.json", put("bytes", 7), r"scene\.clgs has \d+ bytes, not 7"),
    ],
)
def test_a_finished_run_with_a_damaged_file_is_refused(
    finished, dataset, open_device, tmp_path, name, damage, reason
):
    folder = shutil.copytree(finished.folder, tmp_path / "run")
    damage(folder / name)
    before = files(folder)
    device = open_device("cpu")
    with pytest.raises(DataError, match=rf"run: a finished run, but damaged \(.*{reason}.*remove"):
        train_scene(dataset, folder, CONFIG, device=device, resume=True)
    assert files(folder) == before


def test_a_damaged_run_is_made_again_as_the_message_says(finished, dataset, open_device, tmp_path):
    folder = shutil.copytree(finished.folder, tmp_path / "run")
    cut(folder / "scene.clgs")
    (folder / "results.json").unlink()
    again = train_scene(dataset, folder, CONFIG, device=open_device("cpu"), resume=True)
    assert again.bitstream == finished.bitstream == (folder / "scene.clgs").read_bytes()


@pytest.mark.usefixtures("huge_entries")
def test_a_budget_that_is_too_small_writes_nothing(dataset, open_device, tmp_path):
    (tmp_path / "config.toml").write_text("")
    before = files(tmp_path)
    config, device = replace(CONFIG, max_memory=1), open_device("cpu")
    with pytest.raises(
        BudgetError, match=r"view .*r_\d\.png: a row of tiles needs .*--max-memory \d+"
    ):
        train_scene(dataset, tmp_path, config, device=device, resume=True)
    assert files(tmp_path) == before


def test_a_budget_that_is_too_small_later_names_the_step(
    dataset, open_device, tmp_path, monkeypatch
):
    config, device = replace(CONFIG, max_memory=64), open_device("cpu")

    def grow(progress):
        if progress.result.step == 3:
            monkeypatch.setattr(tile_groups, "BYTES_BY_ENTRY", 2**20)

    with pytest.raises(BudgetError, match=r"step [45], view \S*r_\d\.png: a row of tiles needs"):
        train_scene(dataset, tmp_path / "run", config, device=device, on_progress=grow)


@pytest.mark.usefixtures("huge_entries")
def test_the_least_budget_of_all_views_is_named(finished, data, tmp_path, capsys):
    pictures = tmp_path / "pictures"
    command = ["render", str(finished.folder), "--data", str(data), "-o", str(pictures)]
    assert cli.main([*command, "--max-memory", "1"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "enough for all 3 views" in said
    assert not pictures.exists()
    least = int(said.split("--max-memory ")[1].split(",")[0])
    assert cli.main([*command, "--max-memory", str(least - 1)]) == 1
    assert not pictures.exists()
    assert cli.main([*command, "--max-memory", str(least)]) == 0
    assert len(list(pictures.iterdir())) == 3


@pytest.mark.slow
def test_the_smallest_anchor_is_that_of_the_run_unless_another_is_named(
    data, dataset, open_device, tmp_path
):
    run, device = tmp_path / "run", open_device("cpu")
    config = replace(CONFIG, smallest_anchor=1e4)  # all are smaller: nothing but background
    result = train_scene(dataset, run, config, device=device)
    command = ["render", str(run), "--data", str(data)]
    assert cli.main([*command, "-o", str(tmp_path / "nothing")]) == 0
    all_of_it = ["--smallest-anchor", "0", "-o", str(tmp_path / "all")]
    assert cli.main([*command, *all_of_it]) == 0
    nothing, whole = (sorted((tmp_path / name).iterdir()) for name in ("nothing", "all"))
    renders = sorted((run / "test" / "ours_10" / "renders").iterdir())
    for mine, other, trained in zip(nothing, whole, renders, strict=True):
        assert mine.read_bytes() == trained.read_bytes() != other.read_bytes()
    assert result.summary["psnr"] > 0


def test_a_file_where_checkpoints_go_is_named(data, tmp_path, capsys):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "checkpoint").touch()
    assert cli.main(["train", str(data), "-o", str(tmp_path / "run"), "--steps", "3"]) == 2
    assert "checkpoint: is not a folder; remove it\n" in capsys.readouterr().err


def test_the_photos_folder_is_no_run_folder(data, tmp_path, monkeypatch, capsys):
    before = files(data)
    (tmp_path / "link").symlink_to(data)
    monkeypatch.chdir(data)
    for output in (str(data), str(tmp_path / "link"), "."):
        assert cli.main(["train", str(data), "-o", output, "--steps", "3"]) == 2
        assert "is the folder of the photos; name another with -o\n" in capsys.readouterr().err
    assert files(data) == before


no_windows = pytest.mark.skipif(os.name == "nt", reason="folders cannot be locked on Windows")
HOLDER = """
import sys, time
from pathlib import Path
from clgs.train.run.run_folder import FolderLock
lock = FolderLock(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(600)
"""


@no_windows
def test_a_folder_is_held_until_it_is_released(tmp_path):
    lock = FolderLock(tmp_path)
    with pytest.raises(DataError, match="another process works in it"):
        FolderLock(tmp_path)
    lock.release()
    lock.release()
    FolderLock(tmp_path).release()
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@no_windows
def test_a_killed_process_lets_go(tmp_path):
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(DataError, match="another process"):
            FolderLock(tmp_path)
        holder.kill()
    FolderLock(tmp_path).release()


@pytest.mark.slow
@no_windows
def test_a_run_that_goes_on_is_left_alone(dataset, open_device, tmp_path):
    device, run = open_device("cpu"), tmp_path / "run"
    config = replace(preset("default").scaled(20), voxel=0.05, log_interval=10)
    refused = []

    def intrude(progress):
        if progress.result.step == 10:
            with pytest.raises(DataError, match="another process works in it"):
                train_scene(dataset, run, config, device=device)
            for overwrite in (False, True):
                with pytest.raises(DataError, match="another process"):
                    train_scene(
                        dataset, run, config, device=device, resume=not overwrite,
                        overwrite=overwrite,
                    )  # fmt: skip
                refused.append(overwrite)

    alone = train_scene(dataset, tmp_path / "alone", config, device=device)
    found = train_scene(dataset, run, config, device=device, on_progress=intrude)
    assert refused == [False, True]
    assert found.bitstream == alone.bitstream
    again = train_scene(dataset, run, config, device=device, overwrite=True)
    assert again.bitstream == alone.bitstream
