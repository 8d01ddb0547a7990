"""`clgs batch`: the same files with any workers, killed ones too; wrong ones are refused."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from clgs.cli.main import main
from clgs.cluster import engine, worker
from clgs.cluster.batch import train_one, train_scenes
from clgs.cluster.table import read_scenes
from clgs.errors import ClgsError, UsageError
from clgs.train.run.run_folder import RESULTS
from clgs.train.state.checkpoint import checkpoints
from tests.cluster.kill import (
    as_another_version,
    kill_and_wait,
    killed_once,
    needs_dask,
    scheduler_with_a_worker,
)
from tests.small_scene import write_scene

TABLE = """
[settings]
steps = 60
voxel = 0.05
start_points = 2000
checkpoint_interval = 10

[scene.first]
data = "balls"

[scene.second]
data = "balls"
settings = { seed = 1 }
"""

KIND = {"name": "0", "version": "1.2", "device": "a platform, cpu kernels"}


@pytest.fixture
def table(tmp_path):
    write_scene(tmp_path / "balls")
    path = tmp_path / "table.toml"
    path.write_text(TABLE)
    return path


def files(folder):
    """Bytes of every scene by its name."""
    return {path.parent.name: path.read_bytes() for path in folder.glob("*/scene.clgs")}


def test_a_worker_of_another_kind_is_refused_with_a_reason():
    assert worker.difference(KIND, KIND) == ""
    other = worker.difference({**KIND, "version": "1.1"}, KIND)
    assert other == "has clgs 1.1, not 1.2; install the same version"
    card = worker.difference({**KIND, "device": "a platform, gpu kernels"}, KIND)
    assert "class a platform, gpu kernels, not a platform, cpu kernels as that of worker 0" in card
    none = {"name": "1", "version": "1.2", "error": "no OpenCL device; install PoCL"}
    assert worker.difference(none, KIND) == "no OpenCL device; install PoCL"


def test_without_dask_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ClgsError, match=r'pip install "clgs\[distributed\]"'):
        train_scenes(tmp_path / "absent.toml", tmp_path)


@needs_dask
def test_no_scheduler_is_one_line(table, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(engine, "CONNECT_SECONDS", 1)
    address = "tcp://127.0.0.1:1"
    code = main(["batch", str(table), "-o", str(tmp_path / "runs"), "--scheduler", address])
    (line,) = capsys.readouterr().err.splitlines()
    assert code == UsageError.exit_code
    assert line.startswith(f"clgs: error: --scheduler {address}: no scheduler answers")


@needs_dask
@pytest.mark.parametrize(
    ("address", "settings", "said"),
    [
        ("", {}, "is no address"),
        ("tcp://127.0.0.1:0", {}, "is no address (no host, or the port 0); give tcp://HOST:PORT"),
        ("tcp://127.0.0.1:70000", {}, "is no address (no host, or the port 70000); give "),
        ("127.0.0.1:-1", {}, "is no address (no host, or the port -1); give "),
        ("tcp://:8786", {}, "is no address (no host, or the port 8786); give "),
        ("tcp://127.0.0.1:abc", {}, "is no address (invalid literal"),
        ("127.0.0.1", {}, "is no address (missing port number"),
        ("http://127.0.0.1:8786", {}, "is no address (unknown address scheme 'http'"),
        ("tls://127.0.0.1:1", {}, "dask cannot read the files for TLS (none are named); name "),
        ("tls://127.0.0.1:1", {"tls.ca-file": "no.pem", "tls.client.cert": "no.pem"}, "dask cannot "
         "read the files for TLS ([Errno 2] No such file"),
        ("tcp://127.0.0.1:1", {"require-encryption": True}, "dask is set to require encryption"),
    ],
)  # fmt: skip
def test_a_scheduler_that_cannot_be_asked_is_one_line(
    table, tmp_path, monkeypatch, capsys, address, settings, said
):
    from dask import config

    monkeypatch.setattr(engine, "CONNECT_SECONDS", 1)
    words = ["batch", str(table), "-o", str(tmp_path / "runs"), "--scheduler", address]
    with config.set({f"distributed.comm.{name}": value for name, value in settings.items()}):
        assert main(words) == UsageError.exit_code
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"clgs: error: --scheduler {address}: {said}")


@needs_dask
@pytest.mark.slow
def test_two_workers_one_killed_and_this_process_make_the_same_files(table, tmp_path):
    for task in read_scenes(table, tmp_path / "here"):
        assert "psnr" in train_one(task)
    expected = files(tmp_path / "here")
    assert len(set(expected.values())) == 2

    def saved():
        found = tmp_path / "runs" / "first"
        return checkpoints(found / "checkpoint") and not (found / RESULTS).exists()

    tasks = read_scenes(table, tmp_path / "runs")
    with engine.connected(2, None) as client, killed_once(client, saved) as killed:
        rows = engine.run_tasks(client, train_one, tasks, tmp_path / "kernels", lambda row: None)
    assert len(killed) == 1
    assert [row for row in rows if "error" in row] == []
    assert files(tmp_path / "runs") == expected


@pytest.mark.slow
def test_a_scene_in_blocks_is_that_of_clgs_train(table, tmp_path):
    table.write_text(f'{TABLE}blocks = "2x1"\n')
    _, task = read_scenes(table, tmp_path / "runs")
    said = list[str]()
    assert "psnr" in train_one(task, lambda message: said.append(message["doing"]))
    assert any(line.startswith("steps of all blocks ") for line in said)
    options = "--steps 60 --voxel 0.05 --start-points 2000 --checkpoint-interval 10 --seed 1"
    alone = ["train", str(tmp_path / "balls"), "-o", str(tmp_path / "runs" / "alone")]
    assert main([*alone, "--blocks", "2x1", *options.split()]) == 0
    made = files(tmp_path / "runs")
    assert made["second"] == made["alone"]


@needs_dask
@pytest.mark.slow
def test_a_scheduler_that_is_lost_is_one_line(tmp_path, caplog):
    with scheduler_with_a_worker(tmp_path) as (address, process):
        task = {"run": "one", "lock": str(tmp_path / "lock"), "kills": process.pid}
        with engine.connected(1, address) as client:
            (row,) = engine.run_tasks(client, kill_and_wait, [task], tmp_path, lambda row: None)
    assert row["error"].startswith("the scheduler was lost")
    assert "`clgs train` with --resume" in row["error"]
    assert caplog.records == []


@needs_dask
@pytest.mark.slow
def test_the_command_goes_on_past_a_scene_that_fails(table, tmp_path, capsys):
    table.write_text(TABLE + '\n[scene.gone]\ndata = "gone"\n')
    command = ["batch", str(table), "-o", str(tmp_path / "runs"), "--workers", "1"]
    assert main(command) == 3
    out, err = capsys.readouterr()
    assert [line.split(":")[0] for line in sorted(out.splitlines())] == ["first", "second"]
    (line,) = [line for line in err.splitlines() if line.startswith("clgs: error: ")]
    assert line.startswith(f"clgs: error: gone: {tmp_path / 'gone'}: no such folder")
    assert main(command) == 3
    assert capsys.readouterr().out.count("is finished already") == 2


@needs_dask
@pytest.mark.slow
def test_a_worker_with_another_version_is_refused_by_name(table, tmp_path, monkeypatch):
    tasks = read_scenes(table, tmp_path / "runs")
    with engine.connected(1, None) as client:
        with monkeypatch.context() as patch:
            patch.setattr(engine, "describe", as_another_version)
            with pytest.raises(UsageError, match=r"worker 0 at tcp.*: has clgs 0\.0\.1, not "):
                engine.run_tasks(client, train_one, tasks, tmp_path / "k", pytest.fail)
        # one that joins later says so itself, and its run goes to those that are of the kind
        wanted = {**engine.common_kind(client, tmp_path / "k", None), "version": "0.0.1"}
        task = {**tasks[0], "kind": wanted, "kernels": str(tmp_path / "k"), "device": None}
        row = client.submit(worker.run_on_worker, train_one, task).result()
        assert row["refused"].startswith("worker 0: has clgs ")
        with pytest.raises(UsageError, match=r"no worker with clgs 0\.0\.1 on .* is left"):
            engine.usable_workers(client, wanted, tmp_path / "k", None)
    assert not Path(tasks[0]["folder"]).exists()
