"""The worked examples, the tables and the map of ``codec_c/FORMAT.md``, by both decoders."""

from __future__ import annotations

import re
import struct

import numpy as np
import numpy.typing as npt
import pytest

from clgs import _codec, codec
from clgs.codec import chunks, octree, row_coder, splat_packing, streams
from clgs.codec.attribute_model import find_near
from clgs.codec.meta import Layer, pack_layers, pack_weights, unpack_layers, unpack_weights
from clgs.codec.scene_decoder import decode
from clgs.codec.scene_encoder import encode
from clgs.codec.sections import MAGIC, SPLATS, BytesSource, read_section, read_table
from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.scene import QuantizedScene
from codec_c.reader import attributes as reader_attributes
from codec_c.reader import coding
from codec_c.reader import octree as reader_octree
from codec_c.reader.coding import ByteReader, xxh64
from codec_c.reader.details import read_details
from codec_c.reader.files import read_layers
from codec_c.reader.octree import decode_octree
from codec_c.reader.rows import decode_paper_rows, decode_rows, decode_weights
from tests.codec.samples import encode_paper, encode_run_lengths
from tests.codec.scenes import ROOT, assert_same

TEXT = (ROOT / "codec_c" / "FORMAT.md").read_text(encoding="utf-8")
HEX = r"(?:[0-9A-F]{2}(?:[ |\n]+|(?=`)))+"
CELLS = np.array([[5, -2, 7], [5, -2, 8], [6, -1, 8]], np.int32)
OCTREES = {
    7: CELLS[:1],
    8: CELLS,
    9: np.array([[0, 0, 0], [0, 0, 1], [9, 9, 9]], np.int32),
    10: np.array([[0, 0, 0], [1, 0, 0], [0, 0, 2], [0, 0, 4], [1, 0, 5]], np.int32),
}
MATRICES = {
    2: np.array([[0, 0, 0], [0, 0, 0], [1, -2, 0]], np.int32),
    3: np.array([[10], [11], [9], [10]], np.int32),
    4: np.zeros((1000, 3), np.int32),
    18: np.array([[0, 0, 0], [0, 0, 0], [1, -2, 0]], np.int32),
    19: np.array([[10], [11], [9], [10]], np.int32),
}


def section_of(number: int | str) -> str:
    """The text of an example."""
    return re.split(r"\*\*Example \d+[a-z]?\.\*\*|\n##+ ", TEXT.split(f"**Example {number}.**")[1])[
        0
    ]


def documented(number: int | str) -> list[bytes]:
    """The bytes that an example gives: its runs of hexadecimal pairs; blank lines part them."""
    found = re.findall(rf"`({HEX})`|```\n((?:[0-9A-F|\s])+)```", section_of(number))
    parts = [part for run, block in found for part in (run or block).split("\n\n")]
    return [bytes.fromhex(part.replace("|", "")) for part in parts]


def test_examples_and_parts_are_numbered_in_order() -> None:
    parts = [int(number) for number in re.findall(r"^## (\d+)\. ", TEXT, re.MULTILINE)]
    listed = [int(number) for number in re.findall(r"^\| (\d+) \| [A-Z]", TEXT, re.MULTILINE)]
    examples = [int(number) for number in re.findall(r"\*\*Example (\d+)\.\*\*", TEXT)]
    assert parts == listed[: len(parts)] == list(range(1, 13))
    assert examples == list(range(1, 28))
    assert all(documented(number) for number in examples)
    assert max(map(len, TEXT.split("\n"))) <= 120


def map_of_the_file() -> bytes:
    """The bytes of the map; every row must begin with the number of bytes before it."""
    rows = re.findall(r"^ *(\d+)  ((?:[0-9A-F]{2} ?){1,16})(?:  |$)", TEXT, re.MULTILINE)
    data = b""
    for offset, pairs in rows:
        assert int(offset) == len(data)
        data += bytes.fromhex(pairs)
    return data


def scene_of_the_map() -> QuantizedScene:
    """The scene that the map describes."""
    offset, feature = np.zeros((3, 10, 3), np.int32), np.zeros((3, 50), np.int32)
    offset[1, 0], feature[:, 0] = (1, -2, 3), (4, 5, 4)
    mlps = Mlps(np.zeros(MLP_SIZE, np.float32))
    mlps.head("opacity")["output_bias"][:] = 0.5
    anchors = QuantizedAnchors(CELLS, offset, feature, np.full((3, 6), -30, np.int32))
    return QuantizedScene(anchors, mlps)


def test_map_of_a_file() -> None:
    data = map_of_the_file()
    assert encode(scene_of_the_map()) == data
    assert_same(decode(data), scene_of_the_map())


def test_example_of_varints() -> None:
    numbers = [0, -1, 1, 63, -64, 64, 300, 2**31 - 1, -(2**31)]
    (data,) = documented(1)
    reader = ByteReader(data)
    assert [reader.varint() for _ in numbers] == numbers
    reader.finish()


@pytest.mark.parametrize("number", MATRICES)
def test_examples_of_run_lengths(number: int) -> None:
    plain = (encode_run_lengths, decode_rows), (encode_paper, decode_paper_rows)
    encode_rows, read = plain[number >= 18]
    matrix, data = MATRICES[number], documented(number)[-1]
    assert encode_rows(matrix) == data
    assert read(data, *matrix.shape) == matrix.tolist()


def test_example_of_the_directory() -> None:
    position = np.array([[x, 0, 0] for x in range(66)], np.int32)
    headers = {"ANCH": b"", "OFFS": b"", "FEAT": b"\1", "SCAL": b""}
    columns = {tag: [bytes([0x11 + i]), bytes([0x21 + i])] for i, tag in enumerate(chunks.TAGS)}
    spans = [slice(0, 64), slice(64, 66)]
    assert chunks.pack_directory(64, position, spans, headers, columns) == documented(5)[-1]


def test_example_of_two_groups() -> None:
    position = np.array([[x, 0, 0] for x in range(65)], np.int32)
    columns = {tag: [bytes([k]) for k in range(65)] for tag in chunks.TAGS}
    spans = [slice(k, k + 1) for k in range(65)]
    data = chunks.pack_directory(1, position, spans, dict.fromkeys(chunks.TAGS, b""), columns)
    head, rows, last = documented(6)
    assert data[: len(head)] == head
    assert data[len(head) + 512 :] == rows + last


def test_examples_of_layers_and_of_details() -> None:
    (listed,) = documented("6a")
    layers = [Layer(number, struct.pack("<Q", number)) for number in (1, 2)]
    assert pack_layers(layers) == listed
    assert unpack_layers(listed, 3) == layers
    assert read_layers(listed, 3) == [(1, 1), (2, 2)]
    section = documented("6b")[-1]
    streams = {tag: [bytes([0x11 + i]), bytes([0x21 + i])] for i, tag in enumerate(chunks.ROWS)}
    coded = {tag: (b"\1", chunks) for tag, chunks in streams.items()}
    found, body = chunks.pack_details(3, coded)
    assert found == section
    assert body == b"\1\1\1\x11\x12\x13\x21\x22\x23"
    read = read_details(section, 2)
    assert (read.step, read.sizes, read.total()) == (3, [[1, 1, 1]] * 2, len(body))
    assert read.headers == [(1, _codec.crc32c(b"\1"))] * 3
    assert read.crcs == [_codec.crc32c(body[at : at + 3]) for at in (3, 6)]
    assert chunks.unpack_details(section, 2, 0).size == len(body)


@pytest.mark.parametrize("number", OCTREES)
def test_examples_of_octrees(number: int) -> None:
    position, data = OCTREES[number], documented(number)[0]
    assert data[0] == 2
    assert octree.encode(position) == data
    np.testing.assert_array_equal(octree.decode(data, len(position)), position)
    assert decode_octree(data, len(position)) == position.tolist()


def test_examples_of_octrees_in_a_scene_and_of_bare_codes() -> None:
    bare, corner = documented(8)[1], (5, -2, 7)
    assert octree.encode_in(CELLS, corner) == bare
    np.testing.assert_array_equal(octree.decode_in(bare, 3, corner, 1), CELLS)
    assert decode_octree(bare, 3, (list(corner), 1)) == CELLS.tolist()
    np.testing.assert_array_equal(octree.decode(documented(11)[0], 3), CELLS)
    assert decode_octree(documented(11)[0], 3) == CELLS.tolist()


def table_rows(number: int) -> npt.NDArray[np.int32]:
    """The rows of an example of attributes."""
    if number == 12:
        return np.array([[0, 0, 1, 0, -1, 0, 0, 200, 0, 0]], np.int32).T
    if number == 16:
        return np.array([[1, -(2**31), 1, 2**31 - 1]], np.int32).T
    if number == 14:
        rows = np.zeros((2050, 1), np.int32)
        rows[[0, 257, 1000, 2049]] = 1
        return rows
    pairs = re.findall(r"\((-?\d+) (-?\d+)\)", section_of(number).split(". Channel 0")[0])
    return np.array(pairs).astype(np.int32)


@pytest.mark.parametrize("number", [12, 13, 14, 15, 16])
def test_examples_of_attributes(number: int) -> None:
    rows, (header, chunk) = table_rows(number), documented(number)
    model = row_coder.read(header, rows.shape[1])
    assert model.encode(rows) == chunk
    np.testing.assert_array_equal(model.decode(chunk, len(rows)), rows)
    reader = reader_attributes.Attributes(header, rows.shape[1])
    np.testing.assert_array_equal(reader.decode(chunk, len(rows)), rows)


def test_example_of_a_sided_channel() -> None:
    header, data = documented("13a")
    quotient, rest = [0, 1, 0, -1, 0, 1, -1, 0], [0, -1, 1, 1, 0, 0, 1, -1]
    rows, known = np.stack([quotient, rest], 1).astype(np.int32), np.array([True, False])
    model = row_coder.read(header, 2, known)
    assert model.encode(rows) == data
    assert row_coder.table_model(model.tables).header == header
    there = np.stack([quotient, [0] * 8], 1).astype(np.int32)
    np.testing.assert_array_equal(model.decode(data, 8, None, there.copy()), rows)
    reader = reader_attributes.Attributes(header, 2, known.tolist())
    np.testing.assert_array_equal(reader.decode(data, 8, None, there), rows)
    with pytest.raises(ValueError, match="other channels are known"):
        row_coder.read(header, 2)


def test_example_of_near_rows() -> None:
    text, (header, chunk) = section_of(17), documented(17)
    triples = re.findall(r"\((\d) (\d) (\d)\)", text)
    position = np.array(triples).astype(np.int32)
    near = reader_attributes.near_rows(position.tolist())
    assert ["".join(f"{k} " for k in rows).strip() for rows in near[1:]] == [
        "0", "0 1", "0 2 1", "3 2 1 0", "4 3 2 1",
    ]  # fmt: skip
    rows = np.array([[4, 4, 6, 3, -9, -9]], np.int32).T
    model, reader = row_coder.read(header, 1), reader_attributes.Attributes(header, 1)
    assert (reader.channels[0].mixed, reader.channels[0].taps) == (True, [(0, -4, 256)])
    assert model.encode(rows, find_near(position)) == chunk
    np.testing.assert_array_equal(model.decode(chunk, 6, find_near(position)), rows)
    np.testing.assert_array_equal(reader.decode(chunk, 6, near), rows)


def test_headers_of_the_examples_say_what_the_text_says() -> None:
    first, second = reader_attributes.Attributes(documented(13)[0], 2).channels
    assert (first.centre, first.gain) == (10, 64)
    assert first.tables[0].frequencies[:3] == [2048, 1024, 1024]
    assert (second.taps, second.weights) == ([(0, 0, 128)], (0, 4096, 0))
    assert [t.frequencies[:3] for t in second.tables] == [[3584, 256, 256], [1024, 1024, 2048]]
    assert second.classes == [0] + 31 * [1] + 32 * [0]
    first, second = reader_attributes.Attributes(documented(15)[0], 2).channels
    assert (first.centre, first.gain) == (0, 64)
    assert first.tables[0].frequencies[:3] == [2048, 1024, 1024]
    assert (second.centre, second.mixed, second.taps) == (3, True, [])
    assert (second.weights, second.gain, second.span) == ((1365, 4096, 0), 0, 1)


def test_examples_of_weights() -> None:
    pair = np.array([1.0, -1.0], np.float32)
    multiples = np.array([0.5, -0.25, 0.0, 0.75, 0.0], np.float32)
    assert b"\0" + pair.tobytes() == documented(20)[0]
    assert pack_weights(pair, "float32") == documented(21)[0]
    assert pack_weights(multiples, matrices=((2, 2), (1, 1))) == documented(22)[0]
    for number, expected, matrices in (
        (20, pair, ((2, 1),)),
        (21, pair, ((2, 1),)),
        (22, multiples, ((2, 2), (1, 1))),
    ):
        for decoded in (
            unpack_weights(documented(number)[0], matrices),
            decode_weights(documented(number)[0], list(matrices)),
        ):
            np.testing.assert_array_equal(decoded, expected)


def test_examples_of_arrays() -> None:
    lattice = [[0, 0, 0], [1000, 0, 0], [2000, 0, 4000], [0, 3000, 0], [3000, 3000, 2000]]
    clouds = {23: np.empty((0, 3), int), 24: CELLS, 25: np.array(lattice)}
    for number, cloud in clouds.items():
        assert codec.encode_positions(cloud) == documented(number)[0]
        np.testing.assert_array_equal(codec.decode_positions(documented(number)[0]), cloud)
    column = np.array([[7], [7], [8]])
    assert codec.encode_attributes(column) == documented(26)[-1]


def test_example_of_splats() -> None:
    values = np.array([[0, 0, 0, 5], [1, 1, 1, 9], [1, 1, 1, -9]], np.int32)
    some = splat_packing.QuantizedSplats(["x", "y", "z", "opacity"], [0.5, 0.5, 0.5, 0.25], values)
    source = BytesSource(splat_packing.pack(some))
    entries = read_table(source, splats=True).entries
    read = [read_section(source, entries[tag]) for tag in SPLATS]
    assert [bytes(section.data) for section in read] == documented(27)
    assert all(f"{_codec.crc32c(section.data):08X}" in TEXT for section in read[1:])


def numbers_after(mark: str) -> list[int]:
    """The numbers from ``mark`` to the end of its block."""
    text = re.split(r"\n\n|```", TEXT.split(mark)[1])[0]
    return [int(number) for number in re.findall(r"\d+", text)]


def test_tables_of_the_document() -> None:
    assert numbers_after("KNOT[0 .. 96]") == coding.KNOT
    for cell, odds in re.findall(r"STRETCH\[(\d+)\] = (-?\d+)", TEXT):
        assert coding.STRETCH[int(cell)] == int(odds)
    assert numbers_after("ONLY[0 .. 43]") == reader_octree.ONLY
    rows = re.findall(r"row +(\d+)((?: +\d+){8})", TEXT)
    assert len(rows) == len(reader_octree.CHILD)
    for row, line in rows:
        assert [int(number) for number in line.split()] == reader_octree.CHILD[int(row)]
    assert numbers_after("\nGAIN ") == [*reader_octree.GAIN[1:], 0]
    assert numbers_after("31 thresholds") == reader_attributes.THRESHOLDS


def test_signatures_and_hashes_of_the_document() -> None:
    for signature in (MAGIC, streams.POSITIONS, streams.LATTICE, streams.ATTRIBUTES):
        assert signature.hex(" ").upper() in TEXT
    for data in (b"", b"abc"):
        assert xxh64(data) == _codec.xxh64(data)
        assert f"{xxh64(data):016X}" in TEXT
    assert f"{_codec.crc32c(b'123456789'):08X}" in TEXT
    assert _codec.crc32c(b"123456789") == 0xE3069283
    assert _codec.crc32c(b"") == 0
    assert _codec.crc32c(bytes(32)) == 0x8A9136AA  # RFC 3720, B.4
