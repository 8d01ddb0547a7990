"""What a worker does with a task: it checks itself, locks the run's folder, works, and answers.

A task is sent as a dictionary and answers with one, its row. Only what is light is imported before
it runs: the folder of built kernels must be named first.
"""

from __future__ import annotations

import os
import platform
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clgs import __version__
from clgs.errors import ClgsError, explain

if TYPE_CHECKING:
    from clgs.opencl.device import Device

Task = dict[str, Any]
Row = dict[str, Any]
Tell = Callable[[dict[str, Any]], None]
Work = Callable[[Task, Tell], Row]

TOPIC = "clgs"
"""Topic of the messages on progress that workers send."""

INTERVAL = 1.0
"""Seconds between them."""

TRAINING = "training"
"""What a worker says that it does after a step."""

_alone = threading.Lock()
"""A process trains one run at a time, however many threads a worker has."""


def run_on_worker(work: Work, task: Task) -> Row:
    """What ``work(task, tell)`` gives, in a worker of dask.

    An error of the user becomes a row with ``error`` and ``exit_code``: exceptions that are sent
    back would be pickled, a row is plain data. A worker of another kind than ``task["kind"]``
    answers with ``refused``, which says why.
    """
    from distributed import get_worker

    worker = get_worker()
    own = describe(task["kernels"], task["device"], str(worker.name))
    if problem := difference(own, task["kind"]):
        return {"run": task["run"], "refused": f"worker {own['name']}: {problem}"}
    try:
        with _alone, locked(Path(task["lock"])):
            return work(task, lambda message: worker.log_event(TOPIC, message))
    except (ClgsError, OSError) as error:
        message, code = explain(error)
        return {"run": task["run"], "error": message, "exit_code": code}


def describe(kernels: str, device: str | None, name: str) -> dict[str, str]:
    """The kind of this worker, called ``name``: the version of clgs, the class of its device.

    Devices of a class compute the same bits. ``error`` in place of the class: there is none.

    Args:
        kernels: folder in which workers keep built kernels, unless POCL_CACHE_DIR names a place:
            processes side by side must not share one.
        device: number or part of the name.
        name: of the worker.
    """
    own = re.sub(r"[^\w.-]", "_", f"{platform.node()}-{name}")
    os.environ.setdefault("POCL_CACHE_DIR", str(Path(kernels) / own))
    kind = {"name": name, "version": __version__}
    try:
        opened = opened_device(device)
    except ClgsError as error:
        return {**kind, "error": str(error)}
    return {**kind, "device": opened.kind}


def difference(own: dict[str, str], wanted: dict[str, str]) -> str:
    """Why a worker of the kind ``own`` cannot work with those that are ``wanted``; "" if it can.

    Both as of :func:`describe`.
    """
    if own["version"] != wanted["version"]:
        return f"has clgs {own['version']}, not {wanted['version']}; install the same version"
    if "error" in own:
        return own["error"]
    if own["device"] != wanted["device"]:
        return (
            f"its device is of the class {own['device']}, not {wanted['device']} as that of "
            f"worker {wanted['name']}; choose one class by --device"
        )
    return ""


@cache
def opened_device(name: str | None) -> Device:
    """The device, opened once a process: its kernels stay built.

    Raises:
        DeviceError: as of :class:`clgs.Device`.
    """
    from clgs.opencl.device import Device

    return Device(name)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Within the block no other process is; the system lets go of it when a process is killed.

    A scheduler may send the run of a worker that it lost to another one while the first is still
    busy. Where there are no such locks nothing happens.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        import fcntl
    except ImportError:  # not on Windows
        yield
        return
    with path.open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


class Reporter:
    """Says how far a run is, about once every INTERVAL."""

    def __init__(self, run: str, steps: int, tell: Tell) -> None:
        """Report on a run of ``steps`` steps."""
        self._run, self._steps, self._tell = run, steps, tell
        self._reported, self._step = -INTERVAL, 0

    def progress(self, progress: Any) -> None:
        """After every step; ``progress`` as of :func:`clgs.train_scene`."""
        self._step = progress.result.step
        if time.monotonic() - self._reported >= INTERVAL or self._step == self._steps:
            self.now(TRAINING)

    def now(self, doing: str) -> None:
        """Report at once; the first step after other work is reported at once, too."""
        self._reported = time.monotonic() if doing == TRAINING else -INTERVAL
        self._tell({"run": self._run, "step": self._step, "steps": self._steps, "doing": doing})


def forget_peak_memory() -> None:
    """Let the peak of this process's memory be that of now, where the system can (Linux)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
