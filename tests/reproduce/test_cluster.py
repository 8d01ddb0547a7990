"""Runs as tasks of dask end in the same files as runs without it, even if a worker is killed."""

from itertools import pairwise
from pathlib import Path

import pytest

pytest.importorskip("distributed")

from reproduce.table import chosen, entries, jobs, read_table
from reproduce.worker import ROW, run_job

from clgs.cluster.engine import connected, run_tasks
from clgs.cluster.worker import TRAINING
from clgs.train.state.checkpoint import checkpoints
from tests.cluster.kill import killed_once

SAVED = 3
"""Steps of the first checkpoint: a twentieth of 60."""
FACTS = {"state": "of the test", "workers": 2}


@pytest.fixture
def work(table_file, data, tmp_path):
    """``work(folder)``: the jobs of the main rows, in that folder."""
    table = read_table(table_file)
    wanted = chosen(table, ["main"], entries(table))
    return lambda folder: jobs(table, wanted, data, tmp_path / folder, FACTS)


def alone(found):
    """Rows by run, made in this process."""
    return {job["run"]: run_job(job) for job in found}


def same(rows, expected):
    assert sorted(row["run"] for row in rows) == sorted(expected)
    for row in rows:
        assert "error" not in row, row
        for name in ("scene_hash", "sha256", "psnr", "bytes", "anchors"):
            assert row[name] == expected[row["run"]][name], name


@pytest.mark.slow
def test_the_run_of_a_killed_worker_goes_on(work, tmp_path):
    expected = alone(work("alone")[:1])
    found, ended, messages = work("killed")[:1], [], []
    folder = Path(found[0]["folder"])

    def saved():
        return checkpoints(folder / "checkpoint") and not (folder / ROW).exists()

    with connected(2, None) as client, killed_once(client, saved) as killed:
        kernels = tmp_path / "kernels"
        rows = run_tasks(client, run_job, found, kernels, ended.append, messages.append)
    assert len(killed) == 1
    same(rows, expected)
    assert ended == rows
    assert {message["run"] for message in messages} == set(expected)
    same([run_job(found[0], pytest.fail)], expected)  # read: nothing reports progress
    # the first step of every leg is the one reported after another stage
    reported = [(one["doing"] == TRAINING, one["step"]) for one in messages]
    legs = [step for (before, _), (now, step) in pairwise(reported) if now and not before]
    first, second = legs
    assert first == 1
    assert second > SAVED  # it did not start again
