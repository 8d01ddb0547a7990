"""Time and memory of LPIPS: python scripts/bench/lpips.py WEIGHTS.npz [SIZE] [RUNS].

Processor time is that of all threads: divide it by the processors for the time on an idle machine.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from clgs.memory import peak_memory
from clgs.train.quality.lpips import Lpips
from clgs.train.quality.lpips_weights import read_lpips_weights


def main(weights: str, size: str = "800", runs: str = "2") -> None:
    """Print seconds of the clock and of the processors for each pair of random pictures."""
    rng = np.random.default_rng(0)
    render, photo = rng.integers(0, 256, (2, int(size), int(size), 3), np.uint8)
    network = Lpips(read_lpips_weights(Path(weights)))
    before = peak_memory() or 0
    for _ in range(int(runs)):
        clock, processor = time.perf_counter(), time.process_time()
        score = network(render, photo)
        clock, processor = time.perf_counter() - clock, time.process_time() - processor
        print(f"LPIPS {score:.7f}: {clock:.2f} s, {processor:.2f} s of processors", flush=True)
    print(f"peak memory {(peak_memory() or 0) / 1e6:.0f} MB, {before / 1e6:.0f} MB before")


if __name__ == "__main__":
    main(*sys.argv[1:])
