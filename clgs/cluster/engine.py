"""Tasks on dask.distributed: a cluster on this machine, or a scheduler somewhere."""

from __future__ import annotations

import importlib.util
import logging
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from clgs import __version__
from clgs.cluster.worker import TOPIC, Row, Task, Work, describe, difference, run_on_worker
from clgs.errors import ClgsError, UsageError
from clgs.machine import available_memory, repeatedly

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

LOSSES = 1000
"""Workers that a run may lose before it is given up: each of them leaves a checkpoint."""

CONNECT_SECONDS = 30

REPLACE_SECONDS = 5.0
"""Workers that dask has given up, as those killed twice, are started again within this time."""

ATTEMPTS = 5
"""How often workers that are lost while they start, or while they are asked, are tried again."""

QUIET = logging.CRITICAL
"""What dask still reports: not every connection, nor its traceback of a scheduler that is lost."""

TLS = ("CA_FILE", "CLIENT__CERT", "CLIENT__KEY")
"""Ends of the variables that name the files with which dask connects by TLS."""

Message = dict[str, Any]


def require_distributed() -> None:
    """Raise ClgsError if dask.distributed is not installed."""
    if importlib.util.find_spec("distributed") is None:
        raise ClgsError('tasks need dask: pip install "clgs[distributed]"')


@contextmanager
def connected(workers: int, scheduler: str | None) -> Iterator[Client]:
    """A client of the scheduler at an address, or of ``workers`` processes on this machine.

    Raises:
        ClgsError: dask.distributed is not installed.
        UsageError: the address is none, dask lacks what TLS needs, nothing answers at the address,
            or it has no workers.
    """
    require_distributed()
    from dask import config
    from distributed import Client

    for name in ("distributed", "distributed.client"):  # dask gives each a level
        logging.getLogger(name).setLevel(QUIET)
    if scheduler is not None:
        _check_address(scheduler)
        try:
            client = Client(scheduler, timeout=CONNECT_SECONDS)
        except (OSError, ValueError, TypeError) as error:
            problem = " ".join(str(error).split())
            raise UsageError(
                f"--scheduler {scheduler}: no scheduler answers ({problem}); "
                "start one by `dask scheduler`"
            ) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=CONNECT_SECONDS)
            except TimeoutError:
                raise UsageError(
                    f"--scheduler {scheduler}: no worker came in {CONNECT_SECONDS} s; start some "
                    f"by `dask worker {scheduler} --nthreads 1 --memory-limit 0`"
                ) from None
            yield client
        return
    settings = {
        "distributed.scheduler.allowed-failures": LOSSES,
        "distributed.scheduler.work-stealing": False,  # of runs that take hours
    }
    with (
        config.set(settings),
        _local_cluster(workers) as cluster,
        repeatedly(partial(cluster.scale, workers), REPLACE_SECONDS),
        Client(cluster) as client,
    ):
        yield client


def _local_cluster(workers: int) -> LocalCluster:
    """Processes on this machine; they are started again if one is killed meanwhile."""
    from distributed import LocalCluster

    for _ in range(ATTEMPTS):
        try:
            return LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                memory_limit=0,  # none: a worker is not paused or restarted for what it holds
                dashboard_address=":0",
                silence_logs=QUIET,
            )
        except RuntimeError as error:
            problem = error
    raise ClgsError(f"workers do not start ({problem}); free memory, or give fewer --workers")


def _check_address(scheduler: str) -> None:
    """Raise UsageError if dask cannot even ask for a connection to ``scheduler``."""
    from dask import config
    from distributed.comm.addressing import parse_address, parse_host_port
    from distributed.comm.registry import get_backend
    from distributed.security import Security

    try:
        kind, place = parse_address(scheduler)
        get_backend(kind)
        host, port = parse_host_port(place)
        if not host or not 0 < port < 1 << 16:
            raise ValueError(f"no host, or the port {port}")
    except ValueError as error:
        raise UsageError(
            f"--scheduler {scheduler}: is no address ({error}); give tcp://HOST:PORT or "
            "tls://HOST:PORT with a port of 1 to 65535"
        ) from None
    if kind != "tls":
        if config.get("distributed.comm.require-encryption"):
            raise UsageError(
                f"--scheduler {scheduler}: dask is set to require encryption; give tls://{place}"
            )
        return
    try:
        found = Security().get_connection_args("client")["ssl_context"]
        problem = "" if found else "none are named"
    except (OSError, ValueError) as error:
        problem = str(error)
    if problem:
        names = ", ".join(f"DASK_DISTRIBUTED__COMM__TLS__{name}" for name in TLS)
        raise UsageError(
            f"--scheduler {scheduler}: dask cannot read the files for TLS ({problem}); name them "
            f"by {names}"
        )


def run_tasks(
    client: Client,
    work: Work,
    tasks: list[Task],
    kernels: Path,
    on_row: Callable[[Row], None],
    on_message: Callable[[Message], None] = lambda message: None,
    device: str | None = None,
) -> list[Row]:
    """The rows of some runs, in the order in which they end.

    The run of a killed worker goes on elsewhere, from its newest checkpoint. A run that fails has
    a row with ``error`` and ``exit_code``.

    Args:
        client: as of :func:`connected`.
        work: a function of a module that workers have, called with a task and with a function that
            takes messages; what it gives is the row, which has ``run``.
        tasks: plain data, each with run (its name) and lock (path of a file that is locked
            meanwhile).
        kernels: folder in which workers keep built kernels.
        on_row: called with each row as it comes.
        on_message: called with what workers say of their progress, in another thread.
        device: number or part of the name, as workers see it.

    Raises:
        UsageError: workers differ in the version of clgs or in the class of their device.
    """
    from distributed import as_completed

    kind = common_kind(client, kernels, device)
    shared = {"kind": kind, "kernels": str(kernels.resolve()), "device": device}
    named = {task["run"]: {**task, **shared} for task in tasks}
    client.subscribe_topic(TOPIC, lambda event: on_message(event[1]))

    def submit(name: str, workers: list[str] | None = None) -> Any:
        future = client.submit(run_on_worker, work, named[name], pure=False, workers=workers)
        names[future] = name
        return future

    names: dict[Any, str] = {}
    ending = as_completed([submit(name) for name in named])
    rows = []
    for future in ending:
        name = names.pop(future)
        try:
            row = future.result()
        except Exception as error:  # a fault of the program, a lost scheduler, too many losses
            row = {"run": name, "error": _explain(error), "exit_code": ClgsError.exit_code}
        if "refused" in row:  # it joined later: the run goes to one of the others
            logging.getLogger(__name__).warning("%s", row["refused"])
            ending.add(submit(name, usable_workers(client, kind, kernels, device)))
            continue
        rows.append(row)
        on_row(row)
        future.release()
    client.unsubscribe_topic(TOPIC)
    return rows


def common_kind(client: Client, kernels: Path, device: str | None) -> dict[str, str]:
    """What all workers are, as of :func:`clgs.cluster.worker.describe`: the first of them by name.

    Raises:
        UsageError: a worker has another version than this process, no usable device, or one of
            another class than the first.
    """
    kinds = _kinds(client, kernels, device)
    wanted = {**min(kinds.values(), key=lambda kind: kind["name"]), "version": __version__}
    for address, kind in sorted(kinds.items()):
        if problem := difference(kind, wanted):
            raise UsageError(f"worker {kind['name']} at {address}: {problem}")
    return wanted


def usable_workers(
    client: Client, wanted: dict[str, str], kernels: Path, device: str | None
) -> list[str]:
    """The addresses of the workers that are of the kind that is wanted.

    Raises:
        UsageError: there is none.
    """
    kinds = _kinds(client, kernels, device)
    found = [address for address, kind in kinds.items() if not difference(kind, wanted)]
    if not found:
        raise UsageError(f"no worker with clgs {wanted['version']} on {wanted['device']} is left")
    return found


def memory_per_worker(client: Client) -> int | None:
    """Bytes that each worker can have if those of a machine share what is free; None: unknown."""
    free = _ask(client, lambda name: available_memory())
    machines = Counter(urlsplit(address).hostname for address in free)
    shares = [
        None if size is None else size // machines[urlsplit(address).hostname]
        for address, size in free.items()
    ]
    known = [share for share in shares if share is not None]
    return min(known, default=None)


def _kinds(client: Client, kernels: Path, device: str | None) -> dict[str, dict[str, str]]:
    """The kind of every worker by its address."""
    return _ask(client, partial(describe, str(kernels.resolve()), device))


def _ask(client: Client, question: Callable[[str], Any]) -> dict[str, Any]:
    """What ``question`` with the name of a worker gives on each, by its address.

    Workers that are lost meanwhile are left out, and awaited if none is left.

    Raises:
        UsageError: a worker cannot answer, or none came back.
    """
    for _ in range(ATTEMPTS):
        try:
            client.wait_for_workers(1, timeout=CONNECT_SECONDS)
        except TimeoutError:
            break
        found = {}
        for address, facts in client.scheduler_info(n_workers=-1)["workers"].items():
            ask = partial(question, str(facts["id"]))
            answer = client.run(ask, workers=[address], on_error="return").get(address)
            if isinstance(answer, OSError):  # it was lost
                continue
            if isinstance(answer, Exception):  # clgs is missing there, or has no such module
                raise UsageError(f"worker {facts['id']} at {address}: {_explain(answer)}")
            found[address] = answer
        if found:
            return found
    raise UsageError("no worker is left; start some, or repeat the command with --resume")


def _explain(error: Exception) -> str:
    text = " ".join(f"{type(error).__name__}: {error}".split())
    if "CancelledError" in type(error).__name__:
        return (
            f"the scheduler was lost ({text}); start it and repeat the command, `clgs train` with "
            "--resume, which goes on"
        )
    return text
