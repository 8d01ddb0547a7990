"""Chunks: any size and number of threads gives the same scene, and CHNK is believed in nothing."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from clgs import _codec
from clgs.codec import chunks, octree
from clgs.codec.decode import decode, describe
from clgs.codec.encode import encode
from clgs.errors import CodecError
from clgs.reference import xxh64
from tests.codec.damage import checked, contents, rebuilt
from tests.codec.scenes import assert_same, make_golden, random_scene

CHUNKED = make_golden().golden_files()["chunks"]


@pytest.fixture(scope="module")
def scene():
    return random_scene(np.random.default_rng(9), 1500)


@pytest.mark.parametrize("chunk", [64, 65, 100, 1024, 2**24])
def test_every_chunk_size(scene, chunk):
    data = encode(scene, chunk=chunk)
    assert_same(decode(data), decode(encode(scene)))
    count = -(-len(scene.anchors) // chunk)
    assert describe(data)["chunks"] == {"anchors": chunk, "count": count}


@pytest.mark.parametrize("level", ["fast", "default", "max", "paper"])
def test_no_byte_depends_on_the_threads(scene, level):
    data = encode(scene, level, chunk=128, threads=1)
    for threads in (2, 5):
        assert encode(scene, level, chunk=128, threads=threads) == data
        assert_same(decode(data, threads), decode(data, 1))
    assert describe(data)["level"] == level


def test_parts_of_a_cloud_have_corners_of_its_octree():
    position = np.unique(np.random.default_rng(1).integers(0, 999, (500, 3)), axis=0)
    position = octree.in_order(position.astype(np.int32) - 70)
    parts = chunks.spans(len(position), 70)
    low = position.min(axis=0)
    for part, corner in zip(*octree.cut(position, parts), strict=True):
        cells = part - np.array(corner)
        assert (cells >= 0).all()
        size = 1 << int(cells.max()).bit_length()
        assert ((np.array(corner) - low) % size == 0).all()
        np.testing.assert_array_equal(octree.decode(octree.encode(part, corner), len(part)), part)
    assert octree.cut(position[:0], []) == ([], [])


def directory(**changed) -> bytes:
    """CHNK of the small file with columns of its first chunk changed."""
    section = contents(CHUNKED)["CHNK"]
    rows = np.frombuffer(section[36:], chunks._ROW).copy()
    for name, (column, value) in changed.items():
        rows[0][name][column] = value
    return section[:36] + rows.tobytes()


@pytest.mark.parametrize("tag", chunks.TAGS)
def test_chunks_have_checksums_of_their_own(tag):
    column = chunks.TAGS.index(tag)
    with pytest.raises(CodecError, match=rf"section {tag} at byte \d+: checksum differs"):
        decode(rebuilt(CHUNKED, CHNK=directory(crc=(column, 7))))


@pytest.mark.parametrize("tag", chunks.TAGS)
@pytest.mark.parametrize("length", [0, 1, 2**31, 2**32 - 1])
def test_declared_lengths_must_add_up(tag, length):
    column = chunks.TAGS.index(tag)
    with pytest.raises(CodecError, match=rf"section {tag} at byte \d+: \d+ bytes, its chunks have"):
        decode(rebuilt(CHUNKED, CHNK=directory(length=(column, length))))


def test_bytes_may_not_move_from_chunk_to_chunk():
    """Lengths that add up and checksums that are right, but a byte of one chunk is in the next."""
    for column, tag in enumerate(chunks.TAGS):
        section = contents(CHUNKED)["CHNK"]
        rows = np.frombuffer(section[36:], chunks._ROW).copy()
        rows[0]["length"][column] += 1
        rows[1]["length"][column] -= 1
        moved = checked({**contents(CHUNKED), "CHNK": section[:36] + rows.tobytes()})
        with pytest.raises(CodecError, match=rf"section {tag} at byte \d+: chunk \d+: "):
            decode(rebuilt(CHUNKED, CHNK=moved))


def test_corners_must_be_those_of_the_positions():
    rows = np.frombuffer(contents(CHUNKED)["CHNK"][36:], chunks._ROW)
    for name, by in (("least", -1), ("least", 1), ("greatest", -1), ("greatest", 1)):
        for axis in range(3):
            value = int(rows[0][name][axis]) + by
            with pytest.raises(CodecError, match=r"section (CHNK|ANCH) at byte \d+: "):
                decode(rebuilt(CHUNKED, CHNK=directory(**{name: (axis, value)})))


@pytest.mark.parametrize("chunk", [0, 1, 63, 65, 2**24 + 1, 2**32 - 1])
def test_hostile_chunk_sizes(chunk):
    section = struct.pack("<I", chunk) + contents(CHUNKED)["CHNK"][4:]
    with pytest.raises(CodecError, match=r"section \w+ at byte \d+: "):
        decode(rebuilt(CHUNKED, CHNK=section))


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
    rows = np.frombuffer(sections["CHNK"][36:], chunks._ROW)
    swapped = dict(sections)
    head = struct.unpack_from("<9I", sections["CHNK"])
    for column, tag in enumerate(chunks.TAGS):
        ends = head[1 + 2 * column] + np.cumsum(rows["length"][:, column]).astype(int)
        first, second = (sections[tag][a:b] for a, b in zip([0, *ends], ends[:2], strict=False))
        shared = sections[tag][: head[1 + 2 * column]]
        first = first[len(shared) :]
        swapped[tag] = shared + second + first + sections[tag][ends[1] :]
    order = [1, 0, *range(2, len(rows))]
    swapped["CHNK"] = sections["CHNK"][:36] + rows[order].tobytes()
    with pytest.raises(CodecError, match=r"section CHNK at byte \d+: the chunks are not in Morton"):
        decode(rebuilt(CHUNKED, **swapped))


def test_a_file_of_nothing_declares_nothing():
    empty = make_golden().golden_files()["nothing"]
    assert len(contents(empty)["CHNK"]) == 36
    meta = bytearray(contents(empty)["META"])
    meta[164] = 1
    with pytest.raises(CodecError, match="a grid without anchors"):
        decode(rebuilt(empty, META=bytes(meta)))


@pytest.mark.parametrize("size", [*range(70), 1000])
def test_hash_is_xxh64(size):
    data = bytes((7 * i + i // 31) % 256 for i in range(size))
    assert _codec.xxh64(data) == xxh64.xxh64(data)


def test_hash_has_the_published_values():
    assert _codec.xxh64(b"") == 0xEF46DB3751D8E999
    assert _codec.xxh64(b"abc") == 0x44BC2CF5AD770999
