"""A cluster on this machine whose workers are killed while they start, and while they are asked."""

from __future__ import annotations

import os
import signal
import time

import pytest

from clgs.cluster import engine
from clgs.cluster.engine import common_kind, connected, memory_per_worker
from tests.cluster.kill import killed_at_start

pytest.importorskip("distributed", reason="dask.distributed is not installed")


@pytest.mark.slow
def test_a_worker_that_is_killed_while_it_starts_is_started_again():
    with killed_at_start() as killed, connected(1, None) as client:
        assert len(client.run(os.getpid)) == 1
    assert len(killed) == 1


@pytest.mark.slow
def test_workers_that_are_lost_are_awaited_before_they_are_asked(tmp_path):
    with connected(2, None) as client:
        for question in (memory_per_worker, lambda client: common_kind(client, tmp_path, None)):
            for process in client.run(os.getpid).values():
                os.kill(process, signal.SIGKILL)
            assert question(client)


@pytest.mark.slow
def test_a_worker_that_dask_gives_up_is_replaced(monkeypatch):
    """A worker that is killed while it is started again ends so."""
    from dask import config

    monkeypatch.setattr(engine, "REPLACE_SECONDS", 0.2)
    with (
        config.set({"distributed.deploy.lost-worker-timeout": "0.2s"}),
        connected(1, None) as client,
    ):
        (lost,) = client.scheduler_info(n_workers=-1)["workers"]
        client.sync(client.cluster.workers[0].close)
        for _ in range(300):
            found = list(client.scheduler_info(n_workers=-1)["workers"])
            if found and lost not in found:
                break
            time.sleep(0.1)
        assert len(found) == 1
        assert client.submit(os.getpid).result(timeout=60) > 0
