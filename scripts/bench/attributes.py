"""Time of attribute coding on one thread: ``python scripts/bench/attributes.py [ROWS LEVEL ...]``.

Independent Laplace integers of 30, 50 and 6 channels at 1.68, 2.35 and 5.05 bits a symbol. Levels
take turns; each figure is the least of the repeats, in seconds of CPU time, and in nanoseconds a
symbol.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import numpy.typing as npt

from clgs.codec.attributes import row_coder

ROWS, LEVELS, REPEATS = 312_238, ["fast", "default"], 3
GROUPS = {"offset": (30, 1.68), "feature": (50, 2.35), "scale": (6, 5.05)}


def main() -> int:
    """Print one line a level."""
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else ROWS
    levels = sys.argv[2:] or LEVELS
    arrays = [draw(rows, *group) for group in GROUPS.values()]
    best = {level: [float("inf")] * 3 for level in levels}
    for _ in range(REPEATS):
        for level in levels:
            best[level] = list(map(min, best[level], run(arrays, level)))
    symbols = rows * sum(channels for channels, _ in GROUPS.values())
    print(f"{'level':9}{'fit s':>8}{'chunks s':>9}{'encode s':>9}{'decode s':>9}{'ns':>7}{'ns':>7}")
    for level, (fit, chunks, decode) in best.items():
        encode = fit + chunks
        nanoseconds = [f"{1e9 * t / symbols:7.2f}" for t in (encode, decode)]
        print(f"{level:9}{fit:8.3f}{chunks:9.3f}{encode:9.3f}{decode:9.3f}", *nanoseconds, sep="")
    return 0


def draw(rows: int, channels: int, bits: float) -> npt.NDArray[np.int32]:
    """Laplace integers (rows, channels) of so many bits of entropy each."""
    low, high = 0.05, 60.0
    while high / low > 1.0001:
        spread = (low * high) ** 0.5
        low, high = (spread, high) if rounded_entropy(spread) < bits else (low, spread)
    value = np.random.default_rng(channels).laplace(0, spread, (rows, channels))
    return np.rint(value).astype(np.int32)


def rounded_entropy(spread: float) -> float:
    """Bits of a Laplace number of this scale, rounded to an integer."""
    size = np.arange(1, 3001)
    zero, others = -np.expm1(-0.5 / spread), np.exp(-size / spread) * np.sinh(0.5 / spread)
    share = np.maximum(np.concatenate([[zero], others, others]), 1e-300)
    return float(-(share * np.log2(share)).sum())


def run(arrays: list[npt.NDArray[np.int32]], level: str) -> list[float]:
    """Seconds to fit, to encode the chunks, and to decode."""
    times = [0.0] * 3
    chunk = row_coder.CHUNK
    for array in arrays:
        parts = [array[first : first + chunk] for first in range(0, len(array), chunk)]
        start = time.process_time()
        model = row_coder.fit(array, level, chunk)
        fitted = time.process_time()
        data = [model.encode(part) for part in parts]
        encoded = time.process_time()
        reader = row_coder.read(model.header, model.channels)
        decoded = [reader.decode(d, len(p)) for d, p in zip(data, parts, strict=True)]
        end = time.process_time()
        for i, seconds in enumerate((fitted - start, encoded - fitted, end - encoded)):
            times[i] += seconds
        if not all(map(np.array_equal, decoded, parts)):
            raise SystemExit("decoded values differ")
    return times


if __name__ == "__main__":
    sys.exit(main())
