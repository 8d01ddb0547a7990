"""Files that end with a layer of details, in the page's decoder: all floats, and damage."""

import ctypes
import struct

import numpy as np
import pytest

from clgs import _codec
from clgs.codec import row_coder
from clgs.codec.attribute_model import KNOWN, SIDED, empty_model
from clgs.codec.chunks import ROWS, TAGS, known_channels, pack_details
from clgs.codec.reader import SceneReader
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode
from clgs.codec.sections import (
    BODY,
    DETL,
    LAYR,
    BytesSource,
    read_container,
    read_table,
    write_container,
)
from tests.codec.container.damage import directory, rebuilt
from tests.codec.scenes import random_scene
from tests.web import native
from tests.web.scenes import quantized_scene

pytestmark = native.NEEDS

HEADERS = 28
"""Bytes of DETL before the CRCs of chunks."""


@pytest.fixture(scope="module")
def data():
    scene = random_scene(np.random.default_rng(4), 500)
    return encode(scene, chunk=64, layers=3, details=True)


def layer_ends(data):
    """The bytes of the file up to the end of each layer."""
    return [layer["end"] for layer in describe(data)["layers"]]


def sorted_gaussians(page):
    """The page's Gaussians seen from (1, 1, 1), in an order of their own."""
    found = page.gaussians(np.ones(3))
    order = np.lexsort(found["mean"].T)
    return {name: values[order] for name, values in found.items()}


def assert_drawn(library, page, scene):
    """The page draws bit for bit what it draws of a file of ``scene`` without layers.

    Call it last: there is one page at a time.
    """
    found = sorted_gaussians(page)
    wanted = sorted_gaussians(native.Page(library, encode(scene)))
    assert len(wanted["opacity"]) > 0
    for name, values in wanted.items():
        np.testing.assert_array_equal(found[name], values)


@pytest.mark.parametrize("level", ["fast", "default", "max", "paper"])
def test_details_are_the_last_layer(library, level):
    scene = random_scene(np.random.default_rng(4), 1200)
    chunk = 600 if level == "max" else 50  # channels are mixed in long chunks alone
    data = encode(scene, level, chunk=chunk, layers=3, details=True)
    ends, (_, front) = layer_ends(data), native.sizes(library, data)
    for count, end in enumerate(ends, 1):
        page = native.Page(library, data, front)
        assert page.layers == (3, 0)
        page.arrive(end - 1)
        assert page.layers == (3, count - 1)
        page.arrive(end)
        assert page.layers == (3, count)
        assert page.hashes[0] == page.hashes[1]
        assert_drawn(library, page, decode(data, layers=count))


def test_a_whole_file_is_read_at_once(library, data):
    page = native.Page(library, data)
    assert page.layers == (3, 3)
    wanted = decode(data)
    assert page.array("numbers", ctypes.c_double, 1)[0] == len(wanted.anchors)
    assert_drawn(library, page, wanted)


def test_a_scene_of_other_scales_and_far_values(library):
    scene, _ = quantized_scene(1000, 32)
    scene.anchors.feature[::7] *= 4001  # beyond the symbols, with literal bits
    data = encode(scene, layers=2, details=True, importance=np.ones(len(scene.anchors)))
    assert_drawn(library, native.Page(library, data), decode(data))


def test_bytes_may_come_one_by_one(library, data):
    ends, (_, front) = layer_ends(data), native.sizes(library, data)
    page = native.Page(library, data, front)
    for there in range(front, len(data) + 1):
        page.arrive(there)
        assert page.layers[1] == sum(end <= there for end in ends)
    assert_drawn(library, page, decode(data))


def test_a_file_cut_in_the_details_is_the_scene_without_them(library, data):
    ends = layer_ends(data)
    wanted = decode(data, layers=2)
    for size in (ends[1], ends[1] + 1, (ends[1] + ends[2]) // 2, ends[2] - 1):
        page = native.Page(library, data[:size])
        assert page.layers == (3, 2)
        assert_drawn(library, page, wanted)


def test_pictures_go_on_while_details_are_added(library):
    scene, camera = quantized_scene(3000, 32)
    data = encode(scene, chunk=64, layers=2, details=True)
    page = native.Page(library, data, native.sizes(library, data)[1])
    page.arrive(layer_ends(data)[0])
    coarse, done = page.gaussians(camera.centre), []
    for left in page.steps(len(data)):
        done.append(left)
        drawn = page.gaussians(camera.centre)
        assert page.array("numbers", ctypes.c_double, 1)[0] == len(scene.anchors)
        assert abs(len(drawn["mean"]) / len(coarse["mean"]) - 1) < 0.05
        for name in ("mean", "covariance"):  # what is half done is near to both
            ratio = np.abs(drawn[name]).max() / np.abs(coarse[name]).max()
            assert 0.5 < ratio < 2
    assert done == list(range(done[0], -1, -1))
    assert done[0] >= 4 * describe(data)["chunks"]["count"]


def test_damaged_bytes_of_details_are_refused(library, data):
    begin, front = layer_ends(data)[1], native.sizes(library, data)[1]
    rng = np.random.default_rng(3)
    for at in rng.integers(begin, len(data), 60).tolist():
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(rng.integers(8))
        page = native.Page(library, bytes(damaged), front)
        page.arrive(begin)
        assert page.layers == (3, 2)
        for _ in range(2):  # the second time it is the same problem
            with pytest.raises(ValueError, match="details are damaged"):
                page.arrive(len(data))
        assert page.layers == (3, 2)
        with pytest.raises(ValueError, match="copy"):
            native.Page(library, bytes(damaged))


def changed(data, **sections):
    """The file with other bytes in some sections, whose checksums are right."""
    known = read_container(data)[1]
    return write_container({tag: sections.get(tag, bytes(s.data)) for tag, s in known.items()})


def with_details(data, change):
    """The file after ``change(coded)`` of what ``pack_details`` was given, every checksum right."""
    reader = SceneReader(BytesSource(data), read_table(BytesSource(data)))
    body, chunks = bytes(read_container(data)[1][BODY].data), reader.chunks()
    coded = {tag: [b"", []] for tag in ROWS}
    for tag, (place, _) in reader.details.headers.items():
        coded[tag][0] = body[place.offset : place.offset + place.length]
    for chunk in chunks:
        for tag, part in reader.detail_streams(chunk).items():
            coded[tag][1].append(bytes(part.data))
    change(coded)
    section, details = pack_details(reader.details.step, coded)
    return changed(data, DETL=section, BODY=body[: len(body) - reader.details.size] + details)


def test_chunks_whose_checksums_are_right_are_not_believed(library, data):
    rng, said = np.random.default_rng(5), []
    assert with_details(data, lambda coded: None) == data

    def flip(coded):
        stream = coded[ROWS[rng.integers(3)]][1]
        which = int(rng.integers(len(stream)))
        damaged = bytearray(stream[which])
        damaged[rng.integers(len(damaged))] ^= 1 << int(rng.integers(8))
        stream[which] = bytes(damaged)

    for _ in range(60):
        try:
            page = native.Page(library, with_details(data, flip))
            assert page.layers == (3, 3)  # other numbers
        except ValueError as error:
            said.append(str(error))
    assert len(said) > 10
    assert all("copy" in words for words in said)


def zeros_with(channels, known, sided=()):
    """A model of channels that are always 0, some of them known, some sided by the one before."""
    model = empty_model(channels)
    model["coder"][known] = KNOWN
    model["frequency"][known] = 0
    for channel in sided:
        model["coder"][channel], model["taps"][channel] = SIDED, 1
        model["tap"][channel, 0] = channel - 1, 0, -768
    return row_coder.table_model(model)


EVEN = np.flatnonzero(known_channels(100)).tolist()
MODELS = {
    "raw": row_coder.RowModel(100, row_coder.RAW),
    "paper": row_coder.RowModel(100, row_coder.PAPER),
    "none": zeros_with(100, []),
    "first": zeros_with(100, [0]),
    "not the first": zeros_with(100, EVEN[1:]),
    "an odd one too": zeros_with(100, [*EVEN, 7]),
    "sided, none known": zeros_with(100, [], [1]),
    "as it must be": zeros_with(100, EVEN, [1, 99]),
}


@pytest.mark.parametrize("case", MODELS)
def test_headers_of_details_must_know_the_even_channels(library, data, case):
    """Nothing else is wrong: the chunks fit the header, and say that features stay as they are."""
    model = MODELS[case]
    reader = SceneReader(BytesSource(data), read_table(BytesSource(data)))

    def replace(coded):
        rows = [np.zeros((len(chunk), 100), np.int32) for chunk in reader.chunks()]
        coded["FEAT"] = [model.header, [model.encode(zeros) for zeros in rows]]

    file = with_details(data, replace)
    page = native.Page(library, file, native.sizes(library, file)[1])
    if case == "as it must be":
        page.arrive(len(file))
        assert page.layers == (3, 3)
        return
    with pytest.raises(ValueError, match="attributes are damaged"):
        page.arrive(len(file))
    assert page.layers == (3, 2)


@pytest.mark.parametrize("cut", [0, 1, -1])
def test_cut_headers_of_details_are_refused(library, data, cut):
    def shorten(coded):
        coded["SCAL"][0] = coded["SCAL"][0][:cut]

    with pytest.raises(ValueError, match="attributes are damaged"):
        native.Page(library, with_details(data, shorten))


@pytest.mark.parametrize(("known", "sided"), [([], []), ([0], []), (EVEN[:25], []), ([], [3])])
def test_headers_of_chunks_must_know_nothing(library, known, sided):
    """Their values would be read from memory that was never set."""
    scene = random_scene(np.random.default_rng(2), 300)
    scene.anchors.feature[:] = 0
    data, model, column = encode(scene), zeros_with(50, known, sided), TAGS.index("FEAT")
    stream = model.encode(scene.anchors.feature)

    def of_the_model(shared, crcs, table):
        shared[2 * column] = len(model.header)
        table[:, 7 + column] = len(stream)

    other = rebuilt(data, FEAT=model.header + stream, CHNK=directory(data, of_the_model))
    if not known and not sided:
        assert native.Page(library, other).layers == (1, 1)
        return
    with pytest.raises(ValueError, match="attributes are damaged"):
        native.Page(library, other)


def test_damaged_lists_of_details_are_refused(library, data):
    section = bytes(read_container(data)[1][DETL].data)
    rng = np.random.default_rng(6)
    lists = [section[:size] for size in (0, 3, 27, 28, 60, len(section) - 1)]
    lists += [struct.pack("<I", step) + section[4:] for step in (0, 1, 2, 5, 255, 257, 2**32 - 1)]
    lists += [section[:4] + struct.pack("<I", size) + section[8:] for size in (0, 2**31, 2**32 - 1)]
    for at in rng.integers(0, len(section), 60).tolist():
        lists.append(section[:at] + bytes([section[at] ^ 1 << int(rng.integers(8))]))
        lists[-1] += section[at + 1 :]
    for wrong in lists:
        with pytest.raises(ValueError, match="copy"):
            native.Page(library, changed(data, DETL=wrong))
    chunks = describe(data)["chunks"]["count"]
    for size in (-1, 0, 2**31 - 1):
        listed = _codec.runlength_encode(np.full((chunks, 3), size, np.int32), 3)
        with pytest.raises(ValueError, match="details are damaged"):
            native.Page(library, changed(data, DETL=section[: HEADERS + 4 * chunks] + listed))


def test_details_stand_between_the_layers_and_their_bytes_alone(library, data):
    sections = {tag: bytes(part.data) for tag, part in read_container(data)[1].items()}
    body = sections[BODY]
    with pytest.raises(ValueError, match="details are damaged"):
        native.Page(library, changed(data, BODY=body + b"\0"))
    first = [tag for tag in sections if tag not in (LAYR, DETL, BODY)]
    for last in ((DETL, LAYR, BODY), (DETL,), (LAYR, DETL), (DETL, BODY), (LAYR, BODY, DETL)):
        with pytest.raises(ValueError, match=r"copy|newer page"):
            native.Page(library, write_container({tag: sections[tag] for tag in (*first, *last)}))


def test_products_outside_of_int32_are_refused(library):
    scene = random_scene(np.random.default_rng(2), 300)
    scene.anchors.feature[3, 4] = 2**29
    data = encode(scene, layers=2, details=True, importance=np.ones(len(scene.anchors)))
    assert native.Page(library, data).layers == (2, 2)
    section = bytes(read_container(data)[1][DETL].data)
    with pytest.raises(ValueError, match="anchors are damaged"):
        native.Page(library, changed(data, DETL=b"\xff" + section[1:]))
