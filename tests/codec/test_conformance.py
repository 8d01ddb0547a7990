"""Small vectors with the SHA-256 of their bytes: every version of clgs makes the same.

``python -m tests.codec.test_conformance`` writes ``conformance.txt`` anew, after a change of an
encoder.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from clgs.codec import decode_attributes, decode_positions, encode_attributes, encode_positions
from clgs.codec.container.meta import LEVELS
from clgs.codec.octree.position_coder import morton_order

FILE = Path(__file__).with_name("conformance.txt")
Vector = tuple[Callable[[], bytes], Callable[[bytes], np.ndarray], np.ndarray]


def draw(rows: int, channels: int, spread: int) -> np.ndarray:
    """Peaked integers (rows, channels), by integer arithmetic alone."""
    state = np.arange(1, rows * channels + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    state ^= state >> np.uint64(29)
    state *= np.uint64(0xBF58476D1CE4E5B9)
    first, second = ((state >> np.uint64(s) & np.uint64(0xFFFF)).astype(np.int64) for s in (16, 40))
    value = ((first - 32768) * second * spread >> 31) * (first % 3 > 0)
    return value.astype(np.int32).reshape(rows, channels)


def clouds() -> dict[str, np.ndarray]:
    far = np.array([[-(2**31)] * 3, [-(2**31) + 2**21 - 1] * 3])
    found = {
        "no point": np.empty((0, 3), np.int32),
        "one point": np.array([[2**31 - 1, -(2**31), 0]]),
        "two far points": far,
        "cube": np.argwhere(np.ones((5, 5, 5), bool)),
        "line": np.arange(100)[:, None] * np.array([[7, 0, -3]]),
        "scattered": np.unique(draw(60, 3, 2**20), axis=0),
    }
    for depth in range(1, 22):
        found[f"depth {depth}"] = np.array([[0, 0, 0], [1, 0, 0], [2**depth - 1, 5 % 2**depth, 0]])
        found[f"depth {depth}"] = np.unique(found[f"depth {depth}"], axis=0)
    return found


def tables() -> dict[str, np.ndarray]:
    found = {
        "no rows": np.empty((0, 4), np.int32),
        "all equal": np.full((50, 3), -(2**31)),
        "all distinct": np.arange(90).reshape(30, 3) * 1_000_003,
        "extremes": np.array([[2**31 - 1, -(2**31)], [-(2**31), 2**31 - 1], [0, -1]] * 5),
        "zero triplets": draw(40, 30, 3) * (np.arange(40)[:, None] % 2),
    }
    for channels in (1, 2, 3, 5, 16, 64, 256):
        found[f"{channels} channels"] = draw(30, channels, 4)
    for run in (1, 2, 4, 64, 1024, 65536):
        found[f"run of {run}"] = np.r_[np.zeros((run, 1), np.int32), [[1]]]
    return found


def vectors() -> dict[str, Vector]:
    found: dict[str, Vector] = {}
    for name, cloud in clouds().items():
        expected = cloud[morton_order(cloud)] if len(cloud) else cloud
        found[name] = partial(encode_positions, cloud), decode_positions, expected
    for name, table in tables().items():
        for level in LEVELS:
            encode = partial(encode_attributes, table, level)
            found[f"{name}, {level}"] = encode, decode_attributes, table
    return found


def hashes() -> dict[str, str]:
    lines = FILE.read_text(encoding="ascii").splitlines()
    return {line[66:]: line[:64] for line in lines}


@pytest.mark.parametrize("name", vectors())
def test_vector(name):
    encode, decode, expected = vectors()[name]
    data = encode()
    np.testing.assert_array_equal(decode(data), expected)
    assert hashlib.sha256(data).hexdigest() == hashes()[name], "python -m " + __name__


def test_no_vector_is_left_over():
    assert list(hashes()) == list(vectors())
    assert len(vectors()) >= 60


if __name__ == "__main__":
    made = {name: vector[0]() for name, vector in vectors().items()}
    FILE.write_text(
        "".join(f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in made.items()),
        encoding="ascii",
    )
    print(f"{FILE.name}: {len(made)} vectors")
