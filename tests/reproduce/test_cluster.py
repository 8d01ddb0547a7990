"""Runs as tasks of dask end in the same files as runs without it, even if a worker is killed."""

from __future__ import annotations

import os
import signal
import threading
from itertools import pairwise
from pathlib import Path

import pytest

pytest.importorskip("distributed")

from reproduce.cluster import connected, run_jobs
from reproduce.table import chosen, entries, jobs, read_table
from reproduce.worker import ROW, TRAINING, run_job

from clgs.train.state.checkpoint import checkpoints

SAVED = 3
"""Steps of the first checkpoint: a twentieth of 60."""
FACTS = {"state": "of the test", "workers": 2}


@pytest.fixture
def work(table_file, data, tmp_path):
    """``work(folder)``: the jobs of the main rows, in that folder."""
    table = read_table(table_file)
    wanted = chosen(table, ["main"], entries(table))
    return lambda folder: jobs(table, wanted, data, tmp_path / folder, FACTS)


def alone(found, tmp_path):
    """Rows by run, made in this process; its kernels are then there for the workers, too."""
    return {job["run"]: run_job(job, tmp_path / "kernels") for job in found}


def same(rows, expected):
    assert sorted(row["run"] for row in rows) == sorted(expected)
    for row in rows:
        assert "error" not in row, row
        for name in ("scene_hash", "sha256", "psnr", "bytes", "anchors"):
            assert row[name] == expected[row["run"]][name], name


@pytest.mark.slow
def test_two_workers_make_the_same_scenes(work, tmp_path):
    expected = alone(work("alone"), tmp_path)
    assert len({row["scene_hash"] for row in expected.values()}) == 2
    ended, messages = [], []
    with connected(2, None) as client:
        rows = run_jobs(client, work("dask"), ended.append, messages.append)
    same(rows, expected)
    assert ended == rows
    assert {message["run"] for message in messages} == set(expected)
    again = [run_job(job, tmp_path / "kernels", pytest.fail) for job in work("dask")]
    same(again, expected)  # read: nothing reports progress


@pytest.mark.slow
def test_the_run_of_a_killed_worker_goes_on(work, tmp_path):
    expected = alone(work("alone")[:1], tmp_path)
    found, messages = work("killed")[:1], []
    killed, ended = [], threading.Event()
    with connected(2, None) as client:
        processes = client.run(os.getpid)
        words = (client, found[0], processes, killed, ended)
        killer = threading.Thread(target=kill_when_saved, args=words)
        killer.start()
        try:
            rows = run_jobs(client, found, lambda row: None, messages.append)
        finally:
            ended.set()
            killer.join()
    assert len(killed) == 1
    same(rows, expected)
    first, second = first_steps(messages)
    assert first == 1
    assert second > SAVED  # it did not start again


def first_steps(messages):
    """The first step of every leg: the one reported after another stage."""
    reported = [(one["doing"] == TRAINING, one["step"]) for one in messages]
    return [step for (before, _), (now, step) in pairwise(reported) if now and not before]


def kill_when_saved(client, job, processes, killed, ended):
    """SIGKILL for the worker of the job, once there is a checkpoint of its unfinished run."""
    folder = Path(job["folder"])
    while not ended.wait(0.02):
        if checkpoints(folder / "checkpoint") and not (folder / ROW).exists():
            (address,) = (address for address, keys in client.processing().items() if keys)
            os.kill(processes[address], signal.SIGKILL)
            killed.append(address)
            return
