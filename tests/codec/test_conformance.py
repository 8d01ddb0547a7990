"""Small vectors with the SHA-256 of their bytes: every version of clgs makes the same.

The decoders of clgs and the one that is made from FORMAT.md must both give back what was encoded.
``python -m tests.codec.test_conformance`` writes ``conformance.txt`` again, after a change of an
encoder.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from clgs import codec
from clgs.codec import row_coder
from clgs.codec.meta import LEVELS, pack_weights, unpack_weights
from clgs.codec.octree import runs
from codec_c.reader import attributes as reader_attributes
from codec_c.reader import files as reader_files
from codec_c.reader import rows as reader_rows
from tests.codec.samples import (
    clouds,
    decode_paper,
    decode_run_lengths,
    draw,
    encode_paper,
    encode_run_lengths,
    matrices,
    mixed_model,
    tables_model,
)

FILE = Path(__file__).with_name("conformance.txt")
Decoder = Callable[[bytes], np.ndarray]
Vector = tuple[Callable[[], bytes], list[Decoder], np.ndarray]
"""What encodes, what decodes, and what must come back."""

MOST_ROWS = 3000
"""Longer tables are left to the decoders in C."""


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


def model_vectors() -> Iterator[tuple[str, Vector]]:
    """Header and chunks under models of every kind; chunks of 1 to 3 rows have cut off taps."""
    for name, value in matrices().items():
        cases = [("tables", tables_model(value, 300), 300, value)]
        cases += [("mixed", mixed_model(value[:120]), 300, value[:120])]
        if name == "mixture":
            cases += [(f"in {n}", tables_model(value, n), n, value[:12]) for n in (1, 2, 3)]
        for kind, model, chunk, rows in cases:
            yield f"{name}, {kind}", one_model(model, chunk, rows)


def one_model(model: row_coder.RowModel, chunk: int, rows: np.ndarray) -> Vector:
    parts = runs(len(rows), chunk)
    chunks = [model.encode(rows[part]) for part in parts]
    channels = rows.shape[1]

    def decode(decoder: row_coder.RowModel, data: bytes) -> np.ndarray:
        assert data == b"".join([model.header, *chunks])
        counts = [part.stop - part.start for part in parts]
        return np.concatenate([decoder.decode(*c) for c in zip(chunks, counts, strict=True)])

    decoders = [row_coder.read(model.header, channels)]
    decoders += [reader_attributes.Attributes(model.header, channels)]
    encode = partial(b"".join, [model.header, *chunks])
    return encode, [partial(decode, decoder) for decoder in decoders], rows


LARGEST = float(np.float32(3.4028235e38))
SHAPES = ((6, 9), (9, 1), (4, 30), (1, 17))


def weight_vectors() -> Iterator[tuple[str, Vector]]:
    """Four matrices of weights: multiples of powers of two, of several, of none, and extremes."""
    count = sum(rows * columns for rows, columns in SHAPES)
    integers = draw(1, count, 2**20)[0].astype(np.float64)
    found = {f"multiples of 2^-{n}": integers % 4096 * 2.0**-n for n in (5, 10, 20)}
    found["of 3 2^-20"] = integers * 3 * 2.0**-20
    found["any floats"] = integers / 3
    steps = integers % 512 * 2.0**-9
    steps[:54], steps[63:183] = steps[:54] / 8, 0
    found["steps by matrix"] = steps
    pairs = {
        "zeros": (0.0, 0.0),
        "least denormal": (2.0**-149, 0.0),
        "denormals": (2.0**-149 * 4097, -(2.0**-130)),
        "least normal": (2.0**-126, -(2.0**-149)),
        "2^24 - 1 steps": (0.5, 1.0 - 2.0**-24),
        "largest": (LARGEST, -(2.0**104)),
        "power": (2.0**127, -(2.0**127)),
        "too many steps": (1.0, 2.0**-24),
        "too far apart": (2.0**127, 2.0**-149),
        "negative zero": (-0.0, 1.0),
    }
    for name, pair in pairs.items():
        found[name] = np.zeros(count)
        found[name][::11], found[name][5::11] = pair
    for name, value in found.items():
        expected = value.astype(np.float32)
        yield (
            f"weights, {name}",
            (
                partial(pack_weights, expected, matrices=SHAPES),
                [
                    lambda data: unpack_weights(data, SHAPES).view(np.uint32),
                    lambda data: reader_rows.decode_weights(data, list(SHAPES)).view(np.uint32),
                ],
                expected.view(np.uint32),
            ),
        )


def row_vectors() -> Iterator[tuple[str, Vector]]:
    """The two coders of plain rows."""
    coders = {
        "run lengths": (encode_run_lengths, decode_run_lengths, reader_rows.decode_rows),
        "paper": (encode_paper, decode_paper, reader_rows.decode_paper_rows),
    }
    for name, value in matrices().items():
        for channels in (1, 2, 3, 7):
            resized = np.ascontiguousarray(np.resize(value, (min(len(value), 60), channels)))
            for coder, (encode, *functions) in coders.items():
                decoders = [partial(call, shape=resized.shape, function=f) for f in functions]
                yield (
                    f"{coder}, {name} in {channels}",
                    (partial(encode, resized), decoders, resized),
                )


def call(data: bytes, shape: tuple[int, int], function: Callable[..., object]) -> np.ndarray:
    return np.array(function(data, *shape), np.int32)


@cache
def vectors() -> dict[str, Vector]:
    found: dict[str, Vector] = {}
    for name, cloud in clouds().items():
        expected = cloud[codec.morton_order(cloud)] if len(cloud) else cloud
        decoders = [codec.decode_positions, reader_files.decode_positions]
        found[name] = partial(codec.encode_positions, cloud), decoders, expected
    for name, table in tables().items():
        decoders = [codec.decode_attributes]
        if len(table) <= MOST_ROWS:
            decoders.append(reader_files.decode_attributes)
        for level in LEVELS:
            encode = partial(codec.encode_attributes, table, level)
            found[f"{name}, {level}"] = encode, decoders, table
    return found | dict([*model_vectors(), *weight_vectors(), *row_vectors()])


def hashes() -> dict[str, str]:
    lines = FILE.read_text(encoding="ascii").splitlines()
    return {line[66:]: line[:64] for line in lines}


@pytest.mark.parametrize("name", hashes())
def test_vector(name):
    encode, decoders, expected = vectors()[name]
    data = encode()
    for decode in decoders:
        np.testing.assert_array_equal(decode(data), expected)
    assert hashlib.sha256(data).hexdigest() == hashes()[name], "python -m " + __name__


def test_no_vector_is_left_over():
    assert list(hashes()) == list(vectors())


def test_every_feature_of_a_model_is_used():
    """Terms, activity of the own and of other columns, spans and literals."""
    models = [tables_model(matrices()[n]).tables for n in ("triplets", "busy", "mixture")]
    assert models[0]["span"].any()
    assert models[1]["weight"][:, 0].any()
    assert models[1]["weight"][:, 1].any()
    assert models[2]["taps"].max() > 1
    assert models[2]["tap"][..., 1].min() < 0 < models[2]["tap"][..., 1].max()
    assert tables_model(matrices()["spread 3000"]).tables["frequency"][..., 128:].any()


if __name__ == "__main__":
    made = {name: vector[0]() for name, vector in vectors().items()}
    FILE.write_text(
        "".join(f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in made.items()),
        encoding="ascii",
    )
    print(f"{FILE.name}: {len(made)} vectors")
