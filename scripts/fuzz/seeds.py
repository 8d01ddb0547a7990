"""First inputs for the fuzz targets: ``python scripts/fuzz/seeds.py FOLDER``.

Writes FOLDER/<target>/<name>, from the golden files and from small seeded arrays: what a target
reads before the stream (codec_c/fuzz/<target>.c), and a valid stream.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from clgs import _codec
from clgs.codec import attribute_search, octree, row_coder
from clgs.codec.attribute_model import SIDED, find_sides
from clgs.codec.meta import pack_weights
from clgs.codec.reader import SceneReader
from clgs.codec.sections import BytesSource, read_container

GOLDEN = Path(__file__).resolve().parents[2] / "tests" / "codec" / "golden"
Seed = tuple[str, str, bytes]
"""Target, name, input."""


def main() -> None:
    """Write all seeds."""
    folder = Path(sys.argv[1])
    count = 0
    for target, name, data in all_seeds():
        (folder / target).mkdir(parents=True, exist_ok=True)
        (folder / target / name).write_bytes(data)
        count += 1
    print(f"fuzz_seeds: {count} inputs")


def all_seeds() -> list[Seed]:
    """Make at least one seed for every target."""
    return [*golden_seeds(), *matrix_seeds(), *point_seeds(), *weight_seeds()]


def golden_seeds() -> Iterator[Seed]:
    """Streams of the golden files: octrees of their first chunks, rows that list their chunks."""
    for path in sorted(GOLDEN.glob("*.clgs")):
        table, _ = read_container(data := path.read_bytes())
        reader = SceneReader(BytesSource(data), table)
        for chunk in reader.chunks()[:1]:
            points = octree.in_order(reader.positions(chunk))  # from their own corner
            yield "octree", path.stem, count(len(points) - 1, 512) + octree.encode(points)
        rows = reader.head.groups.astype(np.int32)
        yield (
            "runlength",
            path.stem,
            count(len(rows), 256) + b"\x0a" + _codec.runlength_encode(rows, rows.shape[1]),
        )


def count(number: int, usual: int) -> bytes:
    """What ``fuzz_take_count`` reads as this number."""
    return struct.pack("<H", number if number < usual else 0xF000 + number)


def matrices() -> dict[str, np.ndarray]:
    """Small matrices of int32: peaked, wide, constant, smooth, with runs of zero rows."""
    rng = np.random.default_rng(1)
    peaked = np.rint(rng.laplace(0, 2, (60, 4))).astype(np.int32)
    runs = peaked.copy()
    runs[5:40] = 0
    return {
        "peaked": peaked,
        "runs": runs,
        "wide": (rng.integers(-(2**31), 2**31, (20, 3)) >> rng.integers(0, 31, (20, 3))).astype(
            np.int32
        ),
        "constant": np.full((300, 2), -77, np.int32),
        "smooth": np.cumsum(np.rint(rng.laplace(0, 1, (80, 3))), 0).astype(np.int32),
        "one": np.array([[2**31 - 1]], np.int32),
    }


def matrix_seeds() -> Iterator[Seed]:
    """Every matrix by every coder of rows."""
    for name, value in matrices().items():
        rows, channels = value.shape
        wide = bytes([channels - 1])
        yield "runlength", name, count(rows, 256) + wide + _codec.runlength_encode(value, channels)
        yield "paper", name, count(rows, 512) + wide + _codec.paper_encode(value, channels)
        words = pack_weights(value.ravel().view(np.float32), "float32")
        yield "planes", name, count(value.size, 128) + words
        for coder in range(3):
            form = bytes([3 + 4 * (channels - 1) + 28 * coder])
            yield "round_trip", f"{name}_{coder}", form + value.astype("<i4").tobytes()
        for kinds in (b"\0\0", b"\7\7", b"\6\0", b"\6\7", b"\0\6"):  # 6: known, 7: mixed
            fields = [bytes([k]) + struct.pack("<bHHHH", 0, 16, 1024, 512, 256) for k in kinds]
            head = bytes([min(channels, 2) - 1 | 192]) + b"".join(fields[:channels])
            data = head + value[:, :2].astype("<i4").tobytes()
            yield "round_trip_fit", f"{name}_{kinds.hex()}", data
        for level in ("fast", "default", "max"):
            yield from attribute_seeds(f"{name}_{level}", value, level)
            yield from attribute_seeds(f"{name}_{level}_tables", value, level, 3000)
        yield from known_seeds(name, value)
    seldom = (np.arange(2200) % 97 == 5).astype(np.int32)[:, None]  # in eight lanes
    yield next(attribute_seeds("long", seldom, "fast"))


def attribute_seeds(
    name: str, value: np.ndarray, level: str, model_rows: int = 0
) -> Iterator[Seed]:
    """A chunk of the values, the values themselves, and these over and over as a long column.

    Under the model of ``model_rows`` such rows: only more than these few are worth tables.
    """
    if value.shape[1] > 3:
        value = np.resize(value, (len(value), 9))
    rows, channels = value.shape
    channel_bits = {1: 0, 2: 1, 3: 2, 9: 3}[channels]
    model_rows = max(rows, model_rows)
    model = row_coder.fit(np.resize(value, (model_rows, channels)), level, model_rows)
    head = count(rows - 1, 256) + struct.pack("<BH", channel_bits, len(model.header))
    yield "attributes", name, head + model.header + model.encode(value)
    data = struct.pack("<H", len(model.header)) + model.header + value.astype("<i4").tobytes()
    yield "round_trip_attributes", name, bytes([channel_bits | 128]) + data
    yield "round_trip_attributes", f"{name}_long", bytes([channel_bits | 252]) + data


def known_seeds(name: str, value: np.ndarray) -> Iterator[Seed]:
    """The values with every second channel known, which others look at."""
    value = np.resize(value, (len(value), 3))
    chunks = attribute_search.RowChunks(value, [slice(0, len(value))], None, 3)
    plain, _ = attribute_search.fit(chunks, search=True)
    sided = plain.copy()
    before = np.arange(len(value))[:, None] - np.arange(1, 5)
    find_sides(sided, value, before.astype(np.int32), 3, 2)
    sided["coder"][1], sided["weight"][1], sided["span"][1] = SIDED, 0, 1
    chunks.choose(sided)
    for kind, tables in (
        ("tables", plain),
        ("sided", sided),
        ("mixed", attribute_search.mix_all(plain, chunks.sample())),
    ):
        model = row_coder.table_model(tables)
        length = struct.pack("<H", len(model.header))
        head = count(len(value) - 1, 256) + b"\2" + length
        yield "attributes", f"{name}_known_{kind}", head + model.header + model.encode(value)
        data = length + model.header + value.astype("<i4").tobytes()
        yield "round_trip_attributes", f"{name}_known_{kind}", b"\x82" + data


def point_seeds() -> Iterator[Seed]:
    """Points of several kinds as streams, and as what ``round_trip_octree`` reads."""
    rng = np.random.default_rng(2)
    x, y = np.divmod(np.arange(64), 8)
    clouds = {
        "one": np.array([[5, -2, 7]]),
        "two": np.array([[0, 0, 0], [2**21 - 1, 2**21 - 1, 0]]),
        "cube": np.argwhere(np.ones((4, 4, 4), bool)),
        "sheet": np.stack([x, y, (x * x + 3 * y) // 8], 1),
        "scattered": rng.integers(0, 2**21, (30, 3)),
        "dense": np.unique(rng.integers(0, 16, (500, 3)), axis=0),
    }
    for name, cloud in clouds.items():
        position = cloud.astype(np.int32)
        position = position[octree.morton_order(position)]
        stream = octree.encode(position)
        yield "octree", f"points_{name}", count(len(position) - 1, 512) + stream
        code = octree.morton_codes(position)
        yield "round_trip_octree", name, bytes([7, 0, 0, 0, 0]) + code.astype("<u8").tobytes()
        yield "near", name, b"\0" + (position[:150] & 255).astype(np.uint8).tobytes()
        yield "models", name, position.astype("<i2").tobytes()
        yield "ranges", name, position.astype("<i2").tobytes()


def weight_seeds() -> Iterator[Seed]:
    """One matrix of multiples of a power of two, of zeros, of any floats."""
    rng = np.random.default_rng(3)
    for name, step in {"multiples": 2.0**-10, "zeros": 8.0, "floats": 1e-9}.items():
        word = (np.rint(rng.normal(0, 0.1, 120) / step) * step).astype(np.float32)
        yield "weights", name, bytes([0, 11, 9]) + pack_weights(word, matrices=((12, 10),))


if __name__ == "__main__":
    main()
