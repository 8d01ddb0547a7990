"""Files in layers: any beginning is a scene, and LAYR and BODY are believed in nothing."""

from __future__ import annotations

import struct
import tracemalloc
import warnings
from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.scene_decoder import EVERYWHERE, decode, decode_box, describe
from clgs.codec.scene_encoder import encode, sort_anchors
from clgs.codec.sections import BODY, LAYR, BytesSource, FileSource, write_container
from clgs.codec.smaller import choose_layers
from clgs.errors import CodecError, UsageError
from clgs.scene.anchors import take
from clgs.scene.region import Box
from tests.codec.container.damage import contents, patched, rebuilt
from tests.codec.container.mutations import ROOM
from tests.codec.scenes import GOLDEN, assert_same

GOLD = (GOLDEN / "layers.clgs").read_bytes()


@pytest.fixture(scope="module")
def file(scene):
    return encode(scene, chunk=64, layers=4)


def ends(data):
    return [layer["end"] for layer in describe(data)["layers"]]


@pytest.mark.slow
@pytest.mark.parametrize(("layers", "chunk"), [(1, None), (2, 16), (5, None), (64, 16)])
def test_layers_are_the_same_scene(scene, sorted_scene, layers, chunk):
    data = encode(scene, chunk=chunk, layers=layers)
    assert_same(decode(data), sorted_scene)
    plain = encode(scene, chunk=chunk)
    assert describe(data)["content_hash"] == describe(plain)["content_hash"]
    assert encode(decode(data), chunk=chunk) == plain
    found = describe(data)["layers"]
    assert len(found) == layers
    assert sum(layer["anchors"] for layer in found) == len(scene.anchors)
    assert found[-1]["end"] == len(data)
    assert describe(data)["version"] == "1.2"


@pytest.mark.slow
@pytest.mark.parametrize("level", ["fast", "default", "max", "paper"])
def test_no_byte_depends_on_the_threads(scene, sorted_scene, level):
    data = encode(scene, level, chunk=128, threads=1, layers=3)
    assert encode(sorted_scene, level, chunk=128, threads=3, layers=3) == data
    assert_same(decode(data, 3), sorted_scene)


def subset(scene, count):
    """The first ``count`` layers, chosen again."""
    whole = replace(scene, anchors=sort_anchors(scene.anchors))
    return replace(scene, anchors=take(whole.anchors, choose_layers(whole, 4) < count))


def test_every_beginning_is_the_scene_of_its_layers(scene, file):
    for count, end in enumerate(ends(file), 1):
        wanted = subset(scene, count)
        assert_same(decode(file, layers=count), wanted)
        for size in (end, end + 1) if end < len(file) else (end,):
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                assert_same(decode(file[:size]), wanted)
            names = "layer 1" if count == 1 else f"layers 1 to {count}"
            text = f"the file is cut; it has {names} of 4, a coarser scene"
            assert [str(one.message) for one in said] == [text] * (count < 4)
        described = describe(file[:end])
        assert described.get("missing", 0) == len(file) - end
        there = [layer["there"] for layer in described["layers"]]
        assert there == [True] * count + [False] * (4 - count)


def test_a_layer_cut_in_the_middle_is_left_out_also_of_a_box(scene, file):
    first, second, *_ = ends(file)
    with pytest.warns(UserWarning, match="it has layer 1 of 4"):
        part = decode_box(BytesSource(file[: (first + second) // 2]), EVERYWHERE)
    assert_same(part, subset(scene, 1))


def test_a_file_cut_before_its_first_layer_ends_is_refused(file):
    first = ends(file)[0]
    said = "^the file is cut 1 bytes before the end of layer 1 of 4; copy it again$"
    with pytest.raises(CodecError, match=said):
        decode(file[: first - 1])
    for size in range(0, first, 37):
        with pytest.raises(CodecError):
            decode(file[:size])


def test_a_box_of_a_layer_is_read_from_its_bytes_alone(scene, file, sorted_scene, tmp_path):
    position = sorted_scene.anchors.position / np.float64(sorted_scene.scales.position)
    world = sorted_scene.transform.to_world(position)
    box = Box(tuple(np.quantile(world, 0.1, axis=0)), tuple(np.quantile(world, 0.5, axis=0)))
    path = tmp_path / "s.clgs"
    path.write_bytes(file)
    with path.open("rb", buffering=0) as opened:
        source = FileSource(opened)
        found = decode_box(source, box)
        first = FileSource(opened)
        coarse = decode_box(first, box, layers=1)
    assert_same(found, replace(scene, anchors=take(sorted_scene.anchors, box.holds(world))))
    assert first.bytes_read < source.bytes_read < 0.8 * len(file)
    wanted = subset(scene, 1)
    inside = box.holds(wanted.transform.to_world(wanted.anchors.position / np.float64(200)))
    assert_same(coarse, replace(wanted, anchors=take(wanted.anchors, inside)))


@pytest.mark.parametrize("worst", [np.nan, np.inf, -1.0])
def test_importance_that_is_none_is_refused(scene, worst):
    importance = np.ones(len(scene.anchors))
    importance[3] = worst
    with pytest.raises(ValueError, match=r"^importance: a number is not finite or below 0$"):
        encode(scene, layers=2, importance=importance)
    with pytest.raises(ValueError, match=r"^importance: shape is"):
        encode(scene, layers=2, importance=np.ones(len(scene.anchors) - 1))


def test_an_order_needs_layers(scene):
    with pytest.raises(UsageError, match=r"^importance: orders the anchors of a file in layers"):
        encode(scene, importance=np.ones(len(scene.anchors)))


def test_importance_decides_which_anchors_come_first(scene):
    importance = np.zeros(len(scene.anchors))
    importance[[3, 77, 200]] = 1.0
    found = choose_layers(scene, 8, importance)
    assert found[[3, 77, 200]].max() == 0
    assert (np.bincount(found) >= 1).all()
    data = encode(scene, layers=8, importance=importance)
    first = decode(data, layers=1).anchors.position.tolist()
    assert all(scene.anchors.position[i].tolist() in first for i in (3, 77, 200))


def test_numbers_of_layers_that_are_none(scene, file):
    for layers in (0, 65, -1):
        with pytest.raises(UsageError, match=f"^layers: {layers}; 1 to 64"):
            encode(scene, layers=layers)
    few = replace(scene, anchors=take(scene.anchors, slice(0, 3)))
    with pytest.raises(UsageError, match="there are 3"):
        encode(few, layers=4)
    assert len(describe(encode(few, layers=3))["layers"]) == 3
    for layers in (0, 5):
        with pytest.raises(UsageError, match="the file has 4, give 1 to 4"):
            decode(file, layers=layers)
    with pytest.raises(UsageError, match="the file has 1"):
        decode(encode(scene), layers=2)


@pytest.mark.filterwarnings("ignore:the file is cut")
def test_every_flipped_bit_is_seen_in_whole_files_and_in_what_is_read_of_cut_ones(rng):
    size = ends(GOLD)[1]
    for at in rng.integers(0, len(GOLD), 60).tolist():
        damaged = bytearray(GOLD)
        damaged[at] ^= 1 << int(rng.integers(8))
        with pytest.raises(CodecError):
            decode(bytes(damaged))
        if at < size:
            with pytest.raises(CodecError):
                decode(bytes(damaged[:size]))


def layer_list(*layers):
    return struct.pack("<I", len(layers)) + b"".join(struct.pack("<IQ", *one) for one in layers)


def test_lists_of_layers_that_do_not_fit(file):
    good = contents(file)[LAYR]
    layers = list(struct.iter_unpack("<IQ", good[4:]))
    assert rebuilt(file, LAYR=layer_list(*layers)) == file
    (first, one), (second, other), *rest = layers
    for section, said in (
        (b"", "do not hold 1 to 64"),
        (layer_list(), "do not hold 1 to 64"),
        (layer_list(*[(1, 0)] * 65), "do not hold 1 to 64"),
        (good[:-1], "do not hold 1 to 64"),
        (struct.pack("<I", 2**32 - 1) + good[4:], "do not hold 1 to 64"),
        (layer_list((0, one), (first + second, other), *rest), "a layer has no chunks"),
        (layer_list((first + 1, one), (second, other), *rest), "chunks in all"),
        (layer_list((first, one ^ 1), (second, other), *rest), "layer 1 do not match"),
        (layer_list((first + 1, one), (second - 1, other), *rest), "Morton order|do not match"),
    ):
        with pytest.raises(CodecError, match=said) as error:
            decode(rebuilt(file, LAYR=section))
        assert "\n" not in str(error.value)


def test_layers_and_their_chunks_belong_together_at_the_end(file):
    sections = contents(file)
    for tags in (
        [tag for tag in sections if tag != LAYR],
        [tag for tag in sections if tag != BODY],
        [BODY, *(tag for tag in sections if tag != BODY)],
        [*(tag for tag in sections if tag not in (LAYR, BODY)), BODY, LAYR],
    ):
        with pytest.raises(CodecError, match=r"^section"):
            decode(write_container({tag: sections[tag] for tag in tags}))
    with pytest.raises(CodecError):
        decode(rebuilt(file, BODY=sections[BODY] + b"x"))
    with pytest.raises(CodecError):
        decode(file + b"x")


def test_a_size_that_is_only_claimed_takes_no_memory():
    """The entry of BODY, the last one, says 2^39 bytes; CHNK does not."""
    at = 16 + 32 * 8
    assert GOLD[at : at + 4] == b"BODY"
    offset = int.from_bytes(GOLD[at + 8 : at + 16], "little")
    claimed = patched(GOLD, at + 16, struct.pack("<Q", 2**39))
    tracemalloc.start()
    for data in (claimed, claimed[: offset + 9], patched(GOLD, at + 16, b"\xff" * 8)):
        with pytest.raises(CodecError):
            decode(data)
    assert tracemalloc.get_traced_memory()[1] < ROOM
    tracemalloc.stop()
