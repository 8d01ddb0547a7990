"""The worked examples of ``codec_c/FORMAT.md``, by both implementations."""

from __future__ import annotations

import re
from types import ModuleType

import numpy as np
import pytest

from clgs import _codec, codec
from clgs.codec import streams, weights
from clgs.codec.attributes import paper, row_coder, runlength
from clgs.codec.container import chunks, section_table
from clgs.codec.octree import position_coder
from clgs.reference.codec import attributes as attributes_reference
from clgs.reference.codec import octree as octree_reference
from clgs.reference.codec import paper as paper_reference
from clgs.reference.codec import planes as planes_reference
from clgs.reference.codec import runlength as runlength_reference
from clgs.reference.codec import weights as weights_reference
from tests.codec.scenes import ROOT

TEXT = (ROOT / "codec_c" / "FORMAT.md").read_text(encoding="utf-8")
OCTREES = {
    "1": np.array([[5, -2, 7]], np.int32),
    "2": np.array([[5, -2, 7], [5, -2, 8], [6, -1, 8]], np.int32),
    "B": np.array([[5, -2, 7], [5, -2, 8], [6, -1, 8]], np.int32),
    "C": np.array([[0, 0, 0], [0, 0, 1], [9, 9, 9]], np.int32),
}
EXAMPLES = {
    3: ("encode", np.array([[0, 0, 0], [0, 0, 0], [1, -2, 0]], np.int32)),
    4: ("encode", np.array([[10], [11], [9], [10]], np.int32)),
    5: ("encode", np.zeros((1000, 3), np.int32)),
    12: ("encode", np.array([[0, 0, 0], [0, 0, 0], [1, -2, 0]], np.int32)),
    13: ("encode", np.array([[10], [11], [9], [10]], np.int32)),
}


def documented(number: int | str) -> bytes:
    """The bytes that the document gives for an example: its last run of hexadecimal pairs."""
    body = re.split(r"\*\*Example \w+\.\*\*|\n## ", TEXT.split(f"**Example {number}.**")[1])[0]
    runs = re.findall(r"`((?:[0-9A-F]{2}[ |]*)+)`", body)
    return bytes.fromhex(runs[-1].replace("|", ""))


def modules_of(number: int) -> tuple[ModuleType, ModuleType]:
    """The codec's module and the reference that an example is about."""
    return (paper, paper_reference) if number >= 12 else (runlength, runlength_reference)


@pytest.mark.parametrize("number", OCTREES)
def test_example_of_octrees(number):
    position, data = OCTREES[number], documented(number)
    assert octree_reference.encode(position, mode=data[0]) == data
    for module in (position_coder, octree_reference):
        np.testing.assert_array_equal(module.decode(data, len(position)), position)
    if data[0] == 2:
        assert position_coder.encode(position) == data


@pytest.mark.parametrize("number", EXAMPLES)
def test_example(number):
    function, array = EXAMPLES[number]
    for module in modules_of(number):
        assert getattr(module, function)(array) == documented(number)


def test_examples_of_weights():
    pair = np.array([1.0, -1.0], np.float32)
    assert weights.encode(pair, "float32") == planes_reference.encode(pair) == documented(6)
    multiples = np.array([0.5, -0.25, 0.0, 0.75, 0.0], np.float32)
    matrices = ((2, 2), (1, 1))
    assert weights.encode(multiples, matrices=matrices) == documented("W")
    assert weights_reference.encode(multiples, matrices) == documented("W")


def test_example_of_attributes_in_chunks():
    header, chunk = map(
        bytes.fromhex,
        re.findall(r"`([0-9A-F][0-9A-F ]+)`", TEXT.split("**Example A.**")[1].replace("| ", ""))[
            :2
        ],
    )
    rows = np.array([[0, 0, 1, 0, -1, 0, 0, 200, 0, 0]], np.int32).T
    model = row_coder.read(header, 1)
    assert model.encode(rows) == chunk
    np.testing.assert_array_equal(model.decode(chunk, 10), rows)
    channels = attributes_reference.read_header(header, 1)
    assert attributes_reference.write_header(channels) == header
    assert attributes_reference.encode(channels, rows) == chunk


def test_checksum_of_the_document():
    assert "E3069283" in TEXT
    assert _codec.crc32c(b"123456789") == 0xE3069283
    assert _codec.crc32c(b"") == 0
    assert _codec.crc32c(bytes(32)) == 0x8A9136AA  # RFC 3720, B.4


def example_directory() -> bytes:
    """What example 7 describes."""
    position = np.array([[x, 0, 0] for x in range(66)], np.int32)
    headers = {"ANCH": b"", "OFFS": b"", "FEAT": b"\1", "SCAL": b""}
    columns = {tag: [bytes([0x11 + i]), bytes([0x21 + i])] for i, tag in enumerate(chunks.TAGS)}
    return chunks.pack_directory(64, position, [slice(0, 64), slice(64, 66)], headers, columns)


def test_example_of_the_directory():
    text = TEXT.split("**Example 7.**")[1].split("```")[1]
    assert bytes.fromhex(text.replace("|", "")) == example_directory()


def test_example_of_no_positions():
    text = TEXT.split("**Example 8.**")[1]
    data = bytes.fromhex(re.findall(r"`([0-9A-F ]+)`", text)[0])
    assert codec.encode_positions(np.empty((0, 3), int)) == data


def test_signatures_and_hashes_of_the_document():
    for signature in (section_table.MAGIC, streams.POSITIONS, streams.LATTICE, streams.ATTRIBUTES):
        assert signature.hex(" ").upper() in TEXT
    for data in (b"", b"abc"):
        assert f"{_codec.xxh64(data):016X}" in TEXT


def test_parts_are_numbered_in_order():
    numbers = [int(number) for number in re.findall(r"^## (\d+)\. ", TEXT, re.MULTILINE)]
    assert numbers == list(range(1, len(numbers) + 1))
    listed = re.findall(r"(?:: |· )(\d+) ", TEXT.split("Contents")[1].split("\n")[0])
    assert [int(number) for number in listed] == numbers
