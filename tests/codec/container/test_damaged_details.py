"""DETL and the details in BODY are believed in nothing."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest

from clgs import _codec
from clgs.codec import chunks
from clgs.codec.attribute_model import KNOWN, empty_model
from clgs.codec.chunks import pack_rows
from clgs.codec.scene_decoder import EVERYWHERE, decode, decode_box, describe
from clgs.codec.scene_encoder import encode
from clgs.codec.sections import BODY, DETL, LAYR, BytesSource, write_container
from clgs.errors import CodecError
from tests.codec.container.damage import (
    ENTRY,
    HEAD,
    all_places,
    checked,
    contents,
    patched,
    rebuilt,
    unpack_rows,
)
from tests.codec.container.mutations import ROOM
from tests.codec.scenes import GOLDEN

GOLD = (GOLDEN / "details.clgs").read_bytes()
CHANNELS = {"OFFS": 30, "FEAT": 50, "SCAL": 6}
CHUNKS = unpack_rows(contents(GOLD)["CHNK"])[-1]
BEGIN = int(CHUNKS[:, 7:].sum())
"""Where the chunks of GOLD end in BODY."""


def refused(data, said):
    """Both ways of reading refuse the file in one line."""
    for read in (decode, lambda data: decode_box(BytesSource(data), EVERYWHERE)):
        with pytest.raises(CodecError, match=said) as error:
            read(data)
        assert "\n" not in str(error.value)


def with_detl(section):
    return rebuilt(GOLD, DETL=section)


def with_field(at, number):
    """A number of DETL replaced."""
    section = bytearray(contents(GOLD)[DETL])
    section[at : at + 4] = struct.pack("<I", number)
    return with_detl(bytes(section))


def repacked(**changed):
    """Details packed again, some sections' (header, details of each chunk) replaced."""
    sections = contents(GOLD)
    body = sections[BODY]
    details = chunks.unpack_details(sections[DETL], len(CHUNKS), BEGIN)

    def bytes_at(place):
        return body[place.offset : place.offset + place.length]

    coded = {
        tag: (
            bytes_at(details.headers[tag][0]),
            [bytes_at(one[tag]) for one in all_places(details)],
        )
        for tag in chunks.ROWS
    }
    section, rest = chunks.pack_details(details.step, {**coded, **changed})
    return rebuilt(GOLD, DETL=section, BODY=body[:BEGIN] + rest), coded


def test_details_that_are_packed_again_are_the_same_file():
    assert repacked()[0] == rebuilt(GOLD) == GOLD


@pytest.mark.parametrize("step", [0, 2, 4, 254, 256, 257, 2**31 + 1, 2**32 - 1])
def test_steps_are_odd_and_at_most_255(step):
    refused(with_field(0, step), rf"^section DETL at byte \d+: step {step} is not an odd number")


@pytest.mark.parametrize("step", [1, 5, 255])
def test_another_step_is_another_scene(step):
    """Only a whole decode shows it, as it compares hashes."""
    with pytest.raises(CodecError, match=r"^section LAYR at byte \d+: the integers of layer 1 do"):
        decode(with_field(0, step))


@pytest.mark.parametrize("header", range(3))
@pytest.mark.parametrize("length", [0, 2**31 - 1, 2**32 - 1])
def test_lengths_of_headers_must_add_up(header, length):
    said = r"^section BODY at byte \d+: \d+ bytes, its chunks have \d+;"
    refused(with_field(4 + 8 * header, length), said)


@pytest.mark.parametrize("header", range(3))
def test_headers_have_checksums(header):
    section = bytearray(contents(GOLD)[DETL])
    section[8 + 8 * header] ^= 1
    said = r"^section BODY at byte \d+: checksum of the header for (OFFS|FEAT|SCAL) differs;"
    refused(with_detl(bytes(section)), said)


def test_details_of_chunks_have_checksums():
    for chunk in range(len(CHUNKS)):
        section = bytearray(contents(GOLD)[DETL])
        section[28 + 4 * chunk] ^= 1
        said = rf"BODY at byte \d+: chunk {chunk}: the checksum of its details differs;"
        refused(with_detl(bytes(section)), said)


def listed(change):
    """DETL with other numbers of bytes."""
    section = contents(GOLD)[DETL]
    details = chunks.unpack_details(section, len(CHUNKS), BEGIN)
    sizes = details.lengths.copy()
    change(sizes)
    return section[: 28 + 4 * len(CHUNKS)] + _codec.runlength_encode(sizes, 3)


@pytest.mark.parametrize("column", range(3))
def test_lengths_of_details_must_add_up_and_are_not_negative(column):
    def longer(sizes):
        sizes[0, column] += 1

    def huge(sizes):
        sizes[:, column] = 2**31 - 1

    def negative(sizes):
        sizes[:2, column] += [-sizes[0, column] - 1, sizes[0, column] + 1]

    def moved(sizes):
        sizes[:2, column] += [1, -1]

    for change in (longer, huge):
        refused(with_detl(listed(change)), r"^section BODY at byte \d+: \d+ bytes, its chunks have")
    refused(
        with_detl(listed(negative)), r"^section DETL at byte \d+: a chunk has a negative length"
    )
    refused(with_detl(listed(moved)), "the checksum of its details differs")


def test_a_section_that_is_cut_or_longer():
    section = contents(GOLD)[DETL]
    for length in range(len(section)):
        with pytest.raises(CodecError, match=r"^section (DETL|BODY) at byte \d+: ") as error:
            decode(with_detl(section[:length]))
        assert "\n" not in str(error.value)
    for more in (b"\0", section):
        refused(with_detl(section + more), r"^section DETL at byte \d+: ")


@pytest.mark.parametrize("tag", chunks.ROWS)
@pytest.mark.parametrize("mode", [b"", b"\0", b"\2", b"\3", b"\1"])
def test_headers_of_details_are_of_mode_1(tag, mode):
    streams = repacked()[1][tag][1]
    refused(repacked(**{tag: (mode, streams)})[0], r"^section BODY at byte \d+: ")


def header_of(channels, known):
    """A header in which some channels are known, and all others always 0."""
    model = empty_model(channels)
    model["coder"][known] = KNOWN
    model["frequency"][known] = 0
    return _codec.attributes_header(model)


@pytest.mark.parametrize("tag", chunks.ROWS)
def test_every_second_channel_of_details_is_known_and_no_other(tag):
    channels = 2 * CHANNELS[tag]
    even, streams = np.arange(channels) % 2 == 0, repacked()[1][tag][1]
    more, fewer = even.copy(), even.copy()
    more[1], fewer[-2] = True, False
    for known in (more, fewer, ~even, even & False, even | True):
        file = repacked(**{tag: (header_of(channels, known), streams)})[0]
        refused(file, r"^section BODY at byte \d+: other channels are known than must be;")


@pytest.mark.parametrize("tag", chunks.ROWS)
def test_known_channels_elsewhere_are_refused(tag):
    data = encode(decode(GOLD), "fast", chunk=64)
    chunk, shared, crcs, table = unpack_rows(contents(data)["CHNK"])
    column = 1 + chunks.ROWS.index(tag)
    for known in (np.arange(CHANNELS[tag]) == 0, np.ones(CHANNELS[tag], bool)):
        header = header_of(CHANNELS[tag], known)
        section = contents(data)[tag][shared[2 * column] :]
        numbers = shared.copy()
        numbers[2 * column] = len(header)
        directory = pack_rows(chunk, numbers, crcs, table)
        sections = {**contents(data), tag: header + section, "CHNK": directory}
        file = write_container({**sections, "CHNK": checked(sections)})
        refused(file, rf"^section {tag} at byte \d+: other channels are known than must be;")


@pytest.mark.parametrize("tag", chunks.ROWS)
def test_details_of_a_chunk_that_end_elsewhere(tag):
    header, streams = repacked()[1][tag]
    for other in (b"", streams[0] + b"\1", streams[0] + bytes(40), b"\xff" * 50):
        file = repacked(**{tag: (header, [other, *streams[1:]])})[0]
        with pytest.raises(CodecError, match=r"^section (BODY|META) at byte \d+: ") as error:
            decode(file)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [2**29, -(2**29)])
def test_products_outside_of_int32_are_refused(value):
    scene = decode(GOLD)
    scene.anchors.feature[3, 7] = value
    importance = np.ones(len(scene.anchors))
    data = encode(scene, "fast", 64, layers=2, importance=importance, details=True)
    section = contents(data)[DETL]
    said = r"^section BODY at byte \d+: chunk \d+: a coarse value is outside of int32;"
    refused(rebuilt(data, DETL=struct.pack("<I", 255) + section[4:]), said)


def test_details_stand_between_layers_and_body():
    sections = contents(GOLD)
    others = [tag for tag in sections if tag not in (LAYR, DETL, BODY)]
    for tags in (
        [*others, LAYR, BODY, DETL],
        [*others, DETL, LAYR, BODY],
        [DETL, *others, LAYR, BODY],
        [*others, DETL],
        [*others, LAYR, DETL],
        [*others, DETL, BODY],
    ):
        data = write_container({tag: sections[tag] for tag in tags})
        refused(data, r"^section (table at byte 16|DETL|BODY)")
    without = write_container({tag: sections[tag] for tag in [*others, LAYR, BODY]})
    refused(without, r"^section BODY at byte \d+: \d+ bytes, its chunks have")
    entry = HEAD + ENTRY * [*sections].index(DETL)
    assert GOLD[entry : entry + 4] == b"DETL"
    refused(patched(GOLD, entry + 4, bytes(4)), "'DETL' is repeated or malformed")


def test_numbers_that_are_only_claimed_take_no_memory():
    def huge(sizes):
        sizes[:] = 2**31 - 1

    files = [with_field(4, 2**32 - 1), with_detl(listed(huge)), with_detl(b"\3\0\0\0")]
    tracemalloc.start()
    for data in files:
        refused(data, "section")
        with pytest.raises(CodecError):
            describe(data)
    assert tracemalloc.get_traced_memory()[1] < ROOM
    tracemalloc.stop()
