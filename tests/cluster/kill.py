"""SIGKILL for a worker at a chosen moment, and workers of another version."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest

from clgs.cluster import worker

needs_dask = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="needs dask.distributed"
)


def as_another_version(*asked):
    """What a worker with an older clgs would answer."""
    return {**worker.describe(*asked), "version": "0.0.1"}


@contextmanager
def meanwhile(watch):
    """Call ``watch`` in a thread, with an event that is set when the block ends."""
    ended = threading.Event()
    watcher = threading.Thread(target=watch, args=(ended,))
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()


@contextmanager
def killed_once(client, due):
    """Kill the worker that is busy as soon as ``due()`` is true; yields the list of the killed."""
    processes, killed = client.run(os.getpid), []

    def wait(ended):
        while not ended.wait(0.02):
            if due():
                busy = [address for address, keys in client.processing().items() if keys]
                os.kill(processes[busy[0]], signal.SIGKILL)
                killed.append(busy[0])
                return

    with meanwhile(wait):
        yield killed


@contextmanager
def scheduler_with_a_worker(folder):
    """(address, process) of a scheduler, which has a worker; both end with the block."""
    named = folder / "scheduler.json"

    def start(part, words):
        command = [sys.executable, "-m", f"distributed.cli.dask_{part}", *words.split()]
        return subprocess.Popen([*command, "--no-dashboard", "--scheduler-file", str(named)])

    one = start("scheduler", "--host 127.0.0.1 --port 0")
    other = start("worker", "--no-nanny --nthreads 1")
    try:
        while not named.exists():
            time.sleep(0.1)
        yield json.loads(named.read_text())["address"], one
    finally:
        for process in (one, other):
            process.kill()
            process.wait()


def kill_and_wait(task, tell):
    """Work for a worker: it kills the process ``task["kills"]``, and goes on for long."""
    os.kill(task["kills"], signal.SIGKILL)
    time.sleep(600)


@contextmanager
def killed_at_start():
    """Kill the next process that this one starts, as soon as it is there; yields the killed."""
    import psutil

    own, killed = psutil.Process(), []
    before = {child.pid for child in own.children(recursive=True)}

    def wait(ended):
        while not ended.wait(0.002):
            for child in own.children(recursive=True):
                if child.pid not in before and "spawn_main" in " ".join(child.cmdline()):
                    child.kill()
                    killed.append(child.pid)
                    return

    with meanwhile(wait):
        yield killed
