"""Runs as tasks on dask.distributed: a cluster on this machine, or a scheduler somewhere."""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from clgs.errors import ClgsError, UsageError
from reproduce.worker import TOPIC, Job, Row, run_on_worker

if TYPE_CHECKING:
    from distributed import Client

LOSSES = 1000
"""Workers that a run may lose before it is given up: each of them leaves a checkpoint."""

CONNECT_SECONDS = 30

Message = dict[str, Any]


def require_distributed() -> None:
    """Raise ClgsError if dask.distributed is not installed."""
    if importlib.util.find_spec("distributed") is None:
        raise ClgsError('tasks need dask: pip install "clgs[reproduce]"')


@contextmanager
def connected(workers: int, scheduler: str | None) -> Iterator[Client]:
    """A client of the scheduler at an address, or of ``workers`` processes on this machine.

    Raises:
        UsageError: nothing answers at the address.
    """
    from dask import config
    from distributed import Client, LocalCluster

    if scheduler:
        try:
            client = Client(scheduler, timeout=CONNECT_SECONDS)
        except (OSError, ValueError) as error:
            raise UsageError(
                f"--scheduler {scheduler}: no scheduler answers ({error}); "
                "start one by `dask scheduler`"
            ) from None
        with client:
            yield client
        return
    settings = {
        "distributed.scheduler.allowed-failures": LOSSES,
        "distributed.scheduler.work-stealing": False,  # of runs that take hours
    }
    with (
        config.set(settings),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            memory_limit=0,  # none: a worker is not paused or restarted for what it holds
            dashboard_address=":0",
            silence_logs=logging.ERROR,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def run_jobs(
    client: Client,
    jobs: list[Job],
    on_row: Callable[[Row], None],
    on_message: Callable[[Message], None] = lambda message: None,
) -> list[Row]:
    """The rows of some runs, in the order in which they end.

    The run of a killed worker goes on elsewhere, from its newest checkpoint. A run that fails has
    a row with ``error`` and ``exit_code``.

    Args:
        client: as of :func:`connected`.
        jobs: as :func:`reproduce.table.jobs` makes them.
        on_row: called with each row as it comes.
        on_message: called with what workers say of their progress, in another thread.
    """
    from distributed import as_completed

    client.subscribe_topic(TOPIC, lambda event: on_message(event[1]))
    futures = {
        client.submit(run_on_worker, job, key=job["run"], pure=False): job["run"] for job in jobs
    }
    rows = []
    for future in as_completed(futures):
        try:
            row = future.result()
        except Exception as error:  # a fault of the program, or too many killed workers
            text = " ".join(f"{type(error).__name__}: {error}".split())
            row = {"run": futures[future], "error": text, "exit_code": ClgsError.exit_code}
        rows.append(row)
        on_row(row)
        future.release()
    client.unsubscribe_topic(TOPIC)
    return rows
