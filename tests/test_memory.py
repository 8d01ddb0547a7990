"""The C library gives memory that was freed back to the system when it is asked to."""

from __future__ import annotations

import subprocess
import sys

import pytest

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
    done = subprocess.run(
        [sys.executable, "-c", RESIDENT], capture_output=True, text=True, check=True
    )
    at_once, then = map(int, done.stdout.split())
    if at_once > 60e6:
        pytest.skip("this C library keeps nothing")
    assert then > 60e6
