"""`clgs train --blocks`: an ordinary run of merged blocks, the same bytes with any workers."""

from __future__ import annotations

import json
import math
import shutil

import numpy as np
import pytest

from clgs.cli.main import main
from clgs.cluster import block_run as blocks_run
from clgs.cluster import engine
from clgs.cluster.block_plan import read_plan
from clgs.cluster.block_task import block_config, box_text, limited
from clgs.errors import DataError, ExistsError, UsageError
from clgs.scene.storage import load_scene
from clgs.train.config import from_toml
from clgs.train.config.size_settings import ANCHOR_BITS
from clgs.train.run.run_folder import RESULTS, FolderLock
from clgs.train.state.checkpoint import checkpoints
from tests.cluster.kill import as_another_version, killed_once, needs_dask
from tests.small_scene import write_scene

LEAST_HELD = math.ceil(8 * 4_000 / ANCHOR_BITS)
"""The anchors of the smallest file that a size may be asked for, without its MLPs of float32."""

OPTIONS = "--steps 60 --voxel 0.05 --start-points 1000 --checkpoint-interval 5 --growth-interval 10"


@pytest.fixture(scope="module")
def balls(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("data") / "balls", train=8, test=2, size=32)


def train(balls, folder, *words):
    return main(["train", str(balls), "-o", str(folder), *OPTIONS.split(), *words])


@pytest.fixture(scope="module")
def trained(balls, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    assert train(balls, folder, "--blocks", "2x1") == 0
    return folder


def test_blocks_make_an_ordinary_run_that_is_scored_and_read(trained, capsys):
    assert main(["eval", str(trained)]) == 0
    summary = json.loads((trained / RESULTS).read_text())
    assert f"{summary['psnr']:.2f}" in capsys.readouterr().out
    assert summary["psnr"] > 20
    assert summary["steps"] == 60
    assert summary["bytes"] == (trained / "scene.clgs").stat().st_size
    assert (trained / "report.html").is_file()


def test_blocks_learn_their_own_anchors_and_leave_the_networks(trained):
    plan = read_plan(trained / "blocks")
    coarse = load_scene(trained / "coarse" / "scene.npz")
    for number, name in enumerate(plan.cuts.names):
        start = load_scene(trained / "blocks" / name / "start.npz")
        block = load_scene(trained / "blocks" / name / "scene.npz")
        np.testing.assert_array_equal(block.mlps.flat, coarse.mlps.flat)
        box = plan.cuts.box(number, margin=True)
        before, after = (
            {tuple(p): f.tolist() for p, f in zip(p_f.position, p_f.feature, strict=True)}
            for p_f in (start.anchors, block.anchors)
        )
        outside = {p for p in before if not box.holds(np.array([p]))[0]}
        assert outside == {p for p in after if not box.holds(np.array([p]))[0]}
        assert all(before[place] == after[place] for place in outside)
        inside = set(before) & set(after) - outside
        assert sum(before[place] != after[place] for place in inside) > len(inside) / 2


@pytest.mark.parametrize(
    ("limits", "learning"), [({}, 0), ({"most": 900}, 900), ({"held": 90}, 90)]
)
def test_a_block_has_its_part_of_the_anchors_that_there_may_be(trained, limits, learning):
    plan = read_plan(trained / "blocks")
    coarse = len(load_scene(trained / "coarse" / "scene.npz").anchors)
    for number, name in enumerate(plan.cuts.names):
        start = load_scene(trained / "blocks" / name / "start.npz")
        whole = from_toml((trained / "config.toml").read_text(), "config.toml")
        box = box_text(plan.cuts, number, whole.position_q)
        config = block_config(whole, 0.5, box)[0]
        inside = config.learning_box.holds(start.dequantize().anchors.position).sum()
        task = {"coarse": coarse, "most": 0, "held": 0, **limits}
        one = limited(config, start, task)
        room = len(start.anchors) - inside + math.ceil(learning * inside / coarse)
        assert one.max_anchors == (room if "most" in limits else 0)
        held = max(room, LEAST_HELD) if "held" in limits else 0
        assert held <= one.held_anchors <= held + 1


def test_a_finished_run_is_left_as_it_is_and_other_blocks_are_refused(trained, balls, capsys):
    assert train(balls, trained, "--blocks", "2x1") == UsageError.exit_code
    assert "holds a run already" in capsys.readouterr().err
    assert train(balls, trained, "--blocks", "2x1", "--resume") == 0
    assert "is finished already" in capsys.readouterr().out
    assert train(balls, trained, "--blocks", "1x2", "--resume") == UsageError.exit_code
    assert "was begun with 2x1; give that, or auto" in capsys.readouterr().err
    unfinished = trained.parent / "unfinished"
    shutil.copytree(trained, unfinished, ignore=shutil.ignore_patterns(RESULTS))
    shutil.copy(trained / "coarse" / RESULTS, unfinished / "coarse")
    assert train(balls, unfinished, "--blocks", "1x2", "--resume") == UsageError.exit_code
    assert "was begun with 2x1; give that, or auto" in capsys.readouterr().err


def test_a_run_goes_on_as_it_began_in_blocks_or_without(trained, balls, tmp_path, capsys):
    (begun := tmp_path / "begun").mkdir()
    shutil.copytree(trained / "coarse", begun / "coarse")
    for folder in (trained, begun):
        assert train(balls, folder, "--resume") == ExistsError.exit_code
        assert "holds a run in blocks; add --blocks" in capsys.readouterr().err
    assert train(balls, begun) == ExistsError.exit_code
    assert "holds a run already" in capsys.readouterr().err
    shutil.copytree(trained / "blocks", begun / "blocks")
    assert train(balls, begun, "--overwrite") == 0
    assert not (begun / "blocks").exists()
    assert train(balls, begun, "--resume") == 0
    capsys.readouterr()
    assert train(balls, begun, "--blocks", "2x1", "--resume") == ExistsError.exit_code
    assert "holds a run without blocks; leave out --blocks" in capsys.readouterr().err


def test_a_run_that_was_killed_before_its_report_gets_it(trained, balls, tmp_path, capsys):
    folder = shutil.copytree(trained, tmp_path / "run")
    (folder / "report.html").unlink()
    assert train(balls, folder, "--blocks", "2x1", "--resume") == 0
    assert "nothing is changed" not in capsys.readouterr().out
    assert "in 2 blocks" in (folder / "report.html").read_text()


def test_no_other_command_comes_in_before_the_report(trained, balls, tmp_path, monkeypatch):
    folder = shutil.copytree(trained, tmp_path / "run")
    (folder / RESULTS).unlink()
    watched = []

    def watch(name):
        real = getattr(blocks_run, name)

        def guarded(*args, **kwargs):
            with pytest.raises(DataError, match="another process works in it"):
                FolderLock(folder)
            watched.append(name)
            return real(*args, **kwargs)

        monkeypatch.setattr(blocks_run, name, guarded)

    names = ["merged_scene", "repose", "write_run_report"]
    for name in names:
        watch(name)
    assert train(balls, folder, "--blocks", "2x1", "--resume") == 0
    assert watched == names
    FolderLock(folder).release()
    monkeypatch.setattr(blocks_run, "coarse_config", lambda *_: 1 / 0)
    watch("remove_run")
    assert train(balls, folder, "--blocks", "2x1", "--overwrite") == 1
    assert watched[-1] == "remove_run"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--blocks", "0x2"), "--blocks 0x2: is not NxM"),
        (("--blocks", "1x1"), "--blocks 1x1: is the whole scene"),
        (("--workers", "2"), "--workers, --scheduler: train blocks; add --blocks auto"),
        (("--blocks", "2x1", "--exposure"), "--exposure: a photo would have one in each block"),
        (("--blocks", "2x1", "--profile"), "--profile: not with --blocks"),
        (("--blocks", "64x64"), "--blocks: 8 photos suffice for 80 blocks at most; give fewer"),
    ],
)
def test_what_cannot_be_is_one_line(balls, tmp_path, capsys, words, named):
    assert train(balls, tmp_path / "run", *words) == UsageError.exit_code
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"clgs: error: {named}")
    assert not (tmp_path / "run").exists()


@needs_dask
def test_no_scheduler_is_one_line_before_anything_is_trained(balls, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(engine, "CONNECT_SECONDS", 1)
    words = ("--blocks", "auto", "--scheduler", "tcp://127.0.0.1:1")
    assert train(balls, tmp_path / "run", *words) == UsageError.exit_code
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("clgs: error: --scheduler tcp://127.0.0.1:1: no scheduler answers")
    assert not (tmp_path / "run").exists()


@needs_dask
@pytest.mark.slow
def test_two_workers_one_of_them_killed_make_the_same_file(trained, balls, tmp_path, monkeypatch):
    """The killed worker's block has a checkpoint by then, from which the other goes on."""
    folder = tmp_path / "run"
    rows = []

    def saved():
        found = folder / "blocks" / "1-0"
        return checkpoints(found / "checkpoint") and not (found / RESULTS).exists()

    def run_and_kill(client, *args, **kwargs):
        with killed_once(client, saved) as killed:
            rows.extend(engine.run_tasks(client, *args, **kwargs))
        assert len(killed) == 1
        return rows

    monkeypatch.setattr(blocks_run, "run_tasks", run_and_kill)
    assert train(balls, folder, "--blocks", "2x1", "--workers", "2") == 0
    assert sorted(row["run"] for row in rows) == ["0-0", "1-0"]
    for name in ("scene.clgs", "blocks/0-0/scene.clgs", "blocks/1-0/scene.clgs"):
        assert (folder / name).read_bytes() == (trained / name).read_bytes(), name


@needs_dask
@pytest.mark.slow
def test_a_block_that_fails_is_named_and_the_command_goes_on_later(
    balls, trained, tmp_path, capsys, caplog
):
    folder = tmp_path / "run"
    shutil.copytree(trained, folder)
    (folder / RESULTS).unlink()
    shutil.rmtree(folder / "checkpoint")
    start = folder / "blocks" / "0-0" / "start.npz"
    whole = start.read_bytes()
    start.write_bytes(whole[:100])
    words = ("--blocks", "auto", "--workers", "1", "--resume")
    assert train(balls, folder, *words) == DataError.exit_code
    last = capsys.readouterr().err.splitlines()[-1]
    assert not [one for one in caplog.records if one.name.startswith("distributed")]
    assert last.startswith(f"clgs: error: block 0-0: {start}: not a scene archive")
    start.write_bytes(whole)
    assert train(balls, folder, *words) == 0
    assert (folder / "scene.clgs").read_bytes() == (trained / "scene.clgs").read_bytes()


@needs_dask
@pytest.mark.slow
def test_a_worker_of_another_version_is_refused_before_anything_is_trained(
    balls, tmp_path, monkeypatch, capsys
):
    from distributed import LocalCluster

    monkeypatch.setattr(engine, "describe", as_another_version)
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as cluster:
        words = ("--blocks", "2x1", "--scheduler", cluster.scheduler_address)
        assert train(balls, tmp_path / "run", *words) == UsageError.exit_code
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("clgs: error: worker 0 at tcp://")
    assert "has clgs 0.0.1, not " in last
    assert not (tmp_path / "run" / "coarse").exists()
