"""Size and time of the codec on the files of a folder: ``python scripts/bench_codec.py [FOLDER]``.

Prints bytes, the ratio to the published coders' bytes, and nanoseconds of CPU time a symbol (a
point, for positions) to encode and to decode, each the best of three. Single thread.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from clgs.codec import octree, runlength

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data" / "codec"
REPEATS = 3
T = TypeVar("T")
BASELINE = {  # bytes, from the README of that folder
    "scene_q200": 484946,
    "armadillo_sparse_1024": 51899,
    "armadillo_dense_1024": 242340,
    "bunny_4096": 464382,
    "bunny_noisy_2048": 534403,
    "biker_1628": 160897,
    "biker_407": 49801,
    "iid_offset": 252375,
    "iid_feat": 588078,
    "iid_scale": 151649,
    "chan_feat": 530467,
    "zi_offset": 239515,
    "corr_weak": 556432,
    "corr_scale": 144476,
    "biker_scale_q8": 324445,
    "biker_color": 469109,
}


def main() -> int:
    """Print one line a file, and the worst ratio."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    files = sorted(folder.glob("*.npz"))
    if not files:
        print(f"{folder}: no .npz files; name a folder that has some", file=sys.stderr)
        return 3
    print(f"{'file':24}{'symbols':>10}{'bytes':>10}{'ratio':>8}{'enc ns':>8}{'dec ns':>8}")
    ratios = [measure(file) for file in files]
    print(f"worst ratio {max(ratios):.4f}, mean {sum(ratios) / len(ratios):.4f}")
    return 0


def measure(file: Path) -> float:
    """Print the line of one file; its ratio (0 where no baseline is known)."""
    with np.load(file) as arrays:
        name, array = next(iter(arrays.items()))
    array = array.astype(np.int32)
    if name == "positions":
        array = array[octree.morton_order(array)]
        data, encode_time = timed(lambda: octree.encode(array))
        decoded, decode_time = timed(lambda: octree.decode(data, len(array)))
        symbols = len(array)
    else:
        data, encode_time = timed(lambda: runlength.encode(array))
        decoded, decode_time = timed(lambda: runlength.decode(data, *array.shape))
        symbols = array.size
    if not np.array_equal(decoded, array):
        raise SystemExit(f"{file.name}: decoded values differ")
    ratio = len(data) / BASELINE[file.stem] if file.stem in BASELINE else 0.0
    times = f"{encode_time / symbols * 1e9:8.0f}{decode_time / symbols * 1e9:8.0f}"
    print(f"{file.stem:24}{symbols:10}{len(data):10}{ratio:8.4f}{times}", flush=True)
    return ratio


def timed(run: Callable[[], T]) -> tuple[T, float]:
    """The result, and the least CPU seconds of the repeats."""
    best = float("inf")
    for _ in range(REPEATS):
        start = time.process_time()
        result = run()
        best = min(best, time.process_time() - start)
    return result, best


if __name__ == "__main__":
    sys.exit(main())
