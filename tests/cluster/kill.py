"""SIGKILL for a worker at a chosen moment."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import contextmanager


@contextmanager
def killed_once(client, due):
    """Kill the worker that is busy as soon as ``due()`` is true; yields the list of the killed."""
    processes, killed, ended = client.run(os.getpid), [], threading.Event()

    def wait():
        while not ended.wait(0.02):
            if due():
                busy = [address for address, keys in client.processing().items() if keys]
                os.kill(processes[busy[0]], signal.SIGKILL)
                killed.append(busy[0])
                return

    killer = threading.Thread(target=wait)
    killer.start()
    try:
        yield killed
    finally:
        ended.set()
        killer.join()
