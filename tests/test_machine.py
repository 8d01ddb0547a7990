"""This process: its peak of memory, what is freed, and the signals that ask it to end."""

import os
import signal
import sys

import pytest

from clgs.machine import interruptions
from tests.terminal import python

RESIDENT = """
from pathlib import Path
from clgs.machine import return_freed_memory, return_unused_memory

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

return_freed_memory()
kept = [bytes(20_000) for _ in range(4_000)]
before = resident()
kept = kept[::100] + kept[-1:]
freed = resident()
return_unused_memory()
print(before - freed, before - resident())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's heap is Linux's")
def test_pages_between_arrays_in_use_are_given_back():
    at_once, then = map(int, python("-c", RESIDENT).stdout.split())
    if at_once > 60e6:
        pytest.skip("this C library keeps nothing")
    assert then > 60e6


def test_signals_wait_for_the_step():
    # a shell's background job starts with SIGINT ignored
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with interruptions() as interrupted:
            assert not interrupted()
            os.kill(os.getpid(), signal.SIGINT)
            assert interrupted()
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_ignored_signal_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interruptions() as interrupted:
            signal.raise_signal(signal.SIGINT)
            assert not interrupted()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
