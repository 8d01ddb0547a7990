"""Chunks: any size and number of threads gives the same scene, and CHNK is believed in nothing."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from clgs import _codec
from clgs.codec import chunks, octree
from clgs.codec.scene_decoder import EVERYWHERE, decode, decode_box, describe
from clgs.codec.scene_encoder import encode
from clgs.codec.sections import BytesSource, read_table
from clgs.errors import CodecError
from codec_c.reader.coding import xxh64
from tests.codec.container.damage import checked, contents, directory, rebuilt, unpack_rows
from tests.codec.scenes import GOLDEN, assert_same

CHUNKED = (GOLDEN / "chunks.clgs").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [16, 65, 1024, 2**20])
def test_every_chunk_size(scene, sorted_scene, chunk):
    data = encode(scene, chunk=chunk)
    assert_same(decode(data), sorted_scene)
    count = describe(data)["chunks"]["count"]
    assert describe(data)["chunks"] == {"anchors": chunk, "count": count}
    assert count >= len(scene.anchors) / chunk
    assert count <= 1 or count <= 4 * len(scene.anchors) / chunk


@pytest.mark.slow
@pytest.mark.parametrize("level", ["fast", "default", "max", "paper"])
def test_no_byte_depends_on_the_threads(scene, level):
    data = encode(scene, level, chunk=128, threads=1)
    assert encode(scene, level, chunk=128, threads=3) == data
    assert_same(decode(data, 3), decode(data, 1))
    assert describe(data)["level"] == level


def cloud() -> np.ndarray:
    position = np.unique(np.random.default_rng(1).integers(0, 999, (500, 3)), axis=0)
    return octree.in_order(position.astype(np.int32) - 70)


@pytest.mark.parametrize("parts", [octree.runs(500, 70), octree.cut(cloud(), 70)])
def test_parts_of_a_cloud_have_corners_of_its_octree(parts):
    position = cloud()
    low = position.min(axis=0)
    for part, corner in zip(parts, octree.cell_corners(position, parts), strict=True):
        cells = position[part] - np.array(corner)
        assert (cells >= 0).all()
        size = 1 << int(cells.max()).bit_length()
        assert ((np.array(corner) - low) % size == 0).all()
        data = octree.encode(position[part], corner)
        np.testing.assert_array_equal(octree.decode(data, len(cells)), position[part])
    assert octree.cell_corners(position[:0], []) == []


@pytest.mark.parametrize("most", [1, 2, 7, 70, 499, 500, 10**5])
def test_small_parts_are_cells_or_children_of_one(most):
    """Neighbours in one cell stay apart only if they would be too many together."""
    code = octree.morton_codes(cloud())
    parts = octree.cut(cloud(), most)
    assert [part.start for part in parts] == [0, *(part.stop for part in parts[:-1])]
    assert parts[-1].stop == len(code)
    for part in parts:
        assert 1 <= part.stop - part.start <= most
        first, last = int(code[part.start]), int(code[part.stop - 1])
        levels = max(1, -(-(first ^ last).bit_length() // 3))
        for at in (part.start - 1, part.stop):  # no other point lies in one of its children
            if 0 <= at < len(code):
                child = int(code[at]) >> 3 * (levels - 1)
                assert child not in (first >> 3 * (levels - 1), last >> 3 * (levels - 1))
    assert octree.cut(cloud()[:0], most) == []


@pytest.mark.parametrize("count", [0, 1, 100, 20_000, 70_000])
@pytest.mark.parametrize("most", [30, 16_384, 65_536])
def test_batches_hold_every_part_once(count, most):
    parts = octree.runs(count, most)
    batches = octree.batches(parts)
    assert [i for batch in batches for i in batch] == list(range(len(parts)))
    for batch in batches[:-1]:
        assert parts[batch[-1]].stop - parts[batch[0]].start >= octree.COMPACT


def changed(change, fix=False) -> bytes:
    """The small file with another directory."""
    return rebuilt(CHUNKED, CHNK=directory(CHUNKED, change, fix))


@pytest.mark.parametrize("at", range(8))
def test_chunks_have_checksums_of_their_own(at):
    def change(shared, crcs, table):
        assert len(crcs) == 8
        crcs[at] ^= 1

    places, what = "section ANCH", "checksum differs"
    if at >= 4:
        places = r"sections OFFS at byte \d+, FEAT at byte \d+, SCAL"
        what = "the checksum that all of them share differs"
    for read in (decode, lambda data: decode_box(BytesSource(data), EVERYWHERE)):
        with pytest.raises(CodecError, match=rf"^{places} at byte \d+: chunk {at % 4}: {what};"):
            read(changed(change))


@pytest.mark.parametrize("tag", ["OFFS", "FEAT", "SCAL"])
def test_damage_is_told_by_the_section_or_by_all_that_share_a_checksum(tag):
    """A whole decode verifies the sections first; a box reads no more than its chunks."""
    data = bytearray(CHUNKED)
    entry = read_table(BytesSource(CHUNKED)).entries[tag]
    data[entry.offset + entry.length - 1] ^= 1
    with pytest.raises(CodecError, match=rf"^section {tag} at byte \d+: checksum differs"):
        decode(bytes(data))
    with pytest.raises(CodecError, match=r"^sections OFFS at .*, FEAT at .*, SCAL at .*: chunk \d"):
        decode_box(BytesSource(bytes(data)), EVERYWHERE)


@pytest.mark.parametrize("tag", chunks.TAGS)
def test_shared_headers_have_checksums_of_their_own(tag):
    def change(shared, crcs, table):
        shared[2 * chunks.TAGS.index(tag) + 1] ^= 1

    what = "a header that must be empty" if tag == "ANCH" else "checksum of the header"
    with pytest.raises(CodecError, match=rf"section {tag} at byte \d+: {what}"):
        decode(changed(change))


@pytest.mark.parametrize("tag", chunks.TAGS)
@pytest.mark.parametrize("length", [-(2**31), -1, 0, 1, 2**31 - 1])
def test_declared_lengths_must_add_up(tag, length):
    def change(shared, crcs, table):
        table[0, 7 + chunks.TAGS.index(tag)] = length

    what = rf"(CHNK|{tag}) at byte \d+: (a group has a negative length|\d+ bytes, its chunks have)"
    with pytest.raises(CodecError, match=f"section {what}"):
        decode(changed(change))


@pytest.mark.parametrize("tag", chunks.TAGS)
def test_lengths_that_add_up_may_not_be_negative(tag):
    def change(shared, crcs, table):
        column = 7 + chunks.TAGS.index(tag)
        table[:2, column] += [-table[0, column] - 1, table[0, column] + 1]

    with pytest.raises(
        CodecError, match=r"section CHNK at byte \d+: a chunk has a negative length"
    ):
        decode(changed(change))


@pytest.mark.parametrize("tag", chunks.TAGS)
def test_bytes_may_not_move_from_chunk_to_chunk(tag):
    """Lengths that add up and checksums that are right, but a byte of one chunk is in the next."""

    def change(shared, crcs, table):
        table[:2, 7 + chunks.TAGS.index(tag)] += [1, -1]

    with pytest.raises(CodecError, match=rf"section {tag} at byte \d+: chunk \d+: "):
        decode(changed(change, fix=True))


@pytest.mark.parametrize("column", range(1, 7))
def test_corners_must_be_those_of_the_positions(column):
    for by in (-1, 1, 10**6, -(10**6)):

        def change(shared, crcs, table, by=by):
            table[1, column] += by

        with pytest.raises(CodecError, match=r"section (CHNK|ANCH) at byte \d+: "):
            decode(changed(change))


def test_corners_outside_of_int32_are_refused():
    def change(shared, crcs, table):
        table[0, 1:4] = 2**31 - 1
        table[1:, 1:4] = -2

    with pytest.raises(CodecError, match=r"section CHNK at byte \d+: corners"):
        decode(changed(change))


@pytest.mark.parametrize("counts", [(0, 64), (65, 0), (-1, 65), (1, 1), (2**31 - 1, 2**31 - 1)])
def test_hostile_counts_of_anchors(counts):
    def change(shared, crcs, table):
        table[:2, 0] = counts

    with pytest.raises(CodecError, match=r"section (CHNK|ANCH) at byte \d+: "):
        decode(changed(change))


@pytest.mark.parametrize("at", [0, 4])
@pytest.mark.parametrize("number", [0, 1, 2, 5, 2**20 + 1, 2**31, 2**32 - 1])
def test_hostile_chunk_sizes_and_numbers(at, number):
    section = bytearray(contents(CHUNKED)["CHNK"])
    section[at : at + 4] = struct.pack("<I", number)
    with pytest.raises(CodecError, match=r"section CHNK at byte \d+: "):
        decode(rebuilt(CHUNKED, CHNK=bytes(section)))


@pytest.mark.parametrize("at", [*range(152, 168)])
def test_the_grid_must_be_that_of_the_positions(at):
    for value in (1, 128):
        meta = bytearray(contents(CHUNKED)["META"])
        meta[at] ^= value
        if at == 165 and meta[at] < 4:
            continue  # another level, which changes nothing in decoding
        with pytest.raises(CodecError, match=r"section (META|CHNK) at byte \d+: "):
            decode(rebuilt(CHUNKED, META=bytes(meta)))


def test_chunks_in_another_order_are_refused():
    sections = contents(CHUNKED)
    _, shared, _, table = unpack_rows(sections["CHNK"])
    swapped = {}
    for column, tag in enumerate(chunks.TAGS):
        start = shared[2 * column]
        first, second = (int(length) for length in table[:2, 7 + column])
        a = sections[tag][start : start + first]
        b = sections[tag][start + first : start + first + second]
        swapped[tag] = sections[tag][:start] + b + a + sections[tag][start + first + second :]

    def change(shared, crcs, table):
        table[:2] = table[:2][::-1].copy()

    section = directory(CHUNKED, change)
    swapped["CHNK"] = checked({**sections, **swapped, "CHNK": section})
    with pytest.raises(CodecError, match=r"section CHNK at byte \d+: the chunks are not in Morton"):
        decode(rebuilt(CHUNKED, **swapped))


def test_a_file_of_nothing_declares_nothing():
    empty = (GOLDEN / "nothing.clgs").read_bytes()
    assert describe(empty)["chunks"] == {"anchors": 65536, "count": 0}
    meta = bytearray(contents(empty)["META"])
    meta[164] = 1
    with pytest.raises(CodecError, match="a grid without anchors"):
        decode(rebuilt(empty, META=bytes(meta)))
    longer = contents(empty)["CHNK"] + b"\0"
    with pytest.raises(CodecError, match=r"section CHNK at byte \d+: 50 bytes, its chunks have 49"):
        decode(rebuilt(empty, CHNK=longer))


@pytest.mark.parametrize("size", [0, 1, 3, 4, 7, 8, 31, 32, 33, 63, 64, 69, 1000])
def test_hash_is_xxh64(size):
    data = bytes((7 * i + i // 31) % 256 for i in range(size))
    assert _codec.xxh64(data) == xxh64(data)
