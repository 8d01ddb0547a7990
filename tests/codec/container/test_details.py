"""Files whose last layer is the precision of all anchors: any beginning is a scene."""

from __future__ import annotations

import io
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clgs.codec import attribute_search
from clgs.codec.attribute_model import SIDED
from clgs.codec.reader import SceneReader
from clgs.codec.scene_decoder import EVERYWHERE, decode, decode_box, describe
from clgs.codec.scene_encoder import encode, sort_anchors
from clgs.codec.sections import BytesSource, FileSource, read_table
from clgs.codec.smaller import choose_layers
from clgs.errors import CodecError, UsageError
from clgs.scene.anchors import take
from clgs.scene.region import Box
from tests.codec.container.damage import contents, rebuilt
from tests.codec.container.range_server import serve
from tests.codec.samples import INT32
from tests.codec.scenes import GOLDEN, assert_same, random_scene

GOLD = (GOLDEN / "details.clgs").read_bytes()
LEVELS = ["fast", "default", pytest.param("max", marks=pytest.mark.slow), "paper"]


@pytest.fixture(scope="module")
def small():
    return random_scene(np.random.default_rng(21), 200)


@pytest.fixture(scope="module")
def file(scene):
    return encode(scene, "fast", chunk=64, layers=4, details=True)


def ends(data):
    return [layer["end"] for layer in describe(data)["layers"]]


def rounded(scene):
    """The scene with all integers but positions as the nearest multiples of 3."""
    anchors = scene.anchors
    nearest = {
        name: 3 * np.rint(array / 3).astype(np.int32)
        for name, array in anchors.items()
        if name != "position"
    }
    return replace(scene, anchors=replace(anchors, **nearest))


def test_details_that_other_attributes_foretell_take_fewer_bytes(monkeypatch):
    scene = random_scene(np.random.default_rng(22), 1500)
    feature = scene.anchors.feature
    feature[:, 0] *= 3
    feature[:, 1:] = feature[:, :1] + np.clip(feature[:, 1:], -3, 3)
    data = encode(scene, layers=2, details=True)
    reader = SceneReader(BytesSource(data), read_table(BytesSource(data)))
    coders = reader.detail_model("FEAT").tables["coder"][3::2]
    assert (coders == SIDED).mean() > 0.7
    monkeypatch.setattr(attribute_search, "choose_sided", lambda *arguments: None)
    assert len(data) + 500 < len(encode(scene, layers=2, details=True))


def decode_quietly(data):
    """The scene, and what was said of a file that is cut."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        scene = decode(data)
    return scene, [str(one.message) for one in said]


def test_every_beginning_is_the_rounded_scene_of_its_layers(sorted_scene, file):
    *of_anchors, last = ends(file)
    assert last == len(file)
    layer = choose_layers(sorted_scene, 3)
    for count, end in enumerate(of_anchors, 1):
        anchors = take(sorted_scene.anchors, layer < count)
        wanted = rounded(replace(sorted_scene, anchors=anchors))
        assert_same(decode(file, layers=count), wanted)
        names = "layer 1" if count == 1 else f"layers 1 to {count}"
        for size in (end, end + 1):
            found, said = decode_quietly(file[:size])
            assert_same(found, wanted)
            assert said == [f"the file is cut; it has {names} of 4, a coarser scene"]
        there = [layer["there"] for layer in describe(file[:end])["layers"]]
        assert there == [True] * count + [False] * (4 - count)


def test_the_whole_is_the_scene_and_its_description_counts_every_layer(scene, file, sorted_scene):
    found, said = decode_quietly(file)
    assert said == []
    assert_same(found, sorted_scene)
    assert_same(decode(file, layers=4), sorted_scene)
    plain = encode(scene, "fast")
    assert encode(found, "fast") == plain
    info = describe(file)
    assert info["content_hash"] == describe(plain)["content_hash"]
    assert info["version"] == "1.4"
    assert info["bytes"] == sum(info["sections"].values())
    anchors = [layer["anchors"] for layer in info["layers"]]
    assert (anchors[-1], sum(anchors)) == (0, len(scene.anchors))
    for layers in (0, 5):
        with pytest.raises(UsageError, match="the file has 4, give 1 to 4"):
            decode(file, layers=layers)


@pytest.mark.parametrize("level", LEVELS)
def test_no_byte_depends_on_the_threads(small, level):
    data = encode(small, level, chunk=32, threads=1, layers=3, details=True)
    assert encode(small, level, chunk=32, threads=3, layers=3, details=True) == data
    wanted = replace(small, anchors=sort_anchors(small.anchors))
    for threads in (1, 3):
        assert_same(decode(data, threads), wanted)
        assert_same(decode(data, threads, layers=2), rounded(wanted))


@pytest.mark.slow
@pytest.mark.parametrize(("level", "chunk"), [("max", None), ("default", 16), ("paper", 65536)])
def test_details_of_every_size_of_chunks(scene, sorted_scene, level, chunk):
    """Level max mixes channels if chunks are long."""
    data = encode(scene, level, chunk=chunk, layers=2, details=True)
    assert_same(decode(data), sorted_scene)
    assert_same(decode(data, layers=1), rounded(sorted_scene))


def test_a_file_cut_anywhere_in_its_details_has_all_anchors(small):
    data = encode(small, "fast", chunk=64, layers=3, details=True)
    _, second, last = ends(data)
    wanted = decode(data, layers=2)
    assert len(wanted.anchors) == len(small.anchors)
    sizes = [*range(second, second + 9), *range(second + 9, last, 293), last - 1]
    for size in sizes:
        found, said = decode_quietly(data[:size])
        assert_same(found, wanted)
        assert said == ["the file is cut; it has layers 1 to 2 of 3, a coarser scene"]
        with pytest.warns(UserWarning, match="layers 1 to 2 of 3"):
            assert_same(decode_box(BytesSource(data[:size]), EVERYWHERE), wanted)
    assert_same(decode(data[: last - 1], layers=2), wanted)


class Watched(FileSource):
    """Which bytes were read, and how often."""

    def __init__(self, data):
        super().__init__(io.BytesIO(data))
        self.times = np.zeros(len(data), int)

    def read(self, offset, length):
        self.times[offset : offset + length] += 1
        return super().read(offset, length)


def corner_of(scene):
    """A box of a part of the anchors, and these."""
    world = scene.transform.to_world(scene.anchors.position / np.float64(scene.scales.position))
    box = Box(tuple(np.quantile(world, 0.1, axis=0)), tuple(np.quantile(world, 0.5, axis=0)))
    inside = box.holds(world)
    return box, replace(scene, anchors=take(scene.anchors, inside))


def test_a_box_reads_its_chunks_and_their_details_alone(file, sorted_scene):
    box, wanted = corner_of(sorted_scene)
    whole, coarse = Watched(file), Watched(file)
    assert_same(decode_box(whole, box), wanted)
    assert_same(decode_box(coarse, box, layers=3), rounded(wanted))
    assert coarse.bytes_read < whole.bytes_read < 0.8 * len(file)
    assert whole.times.max() == 1
    begin = ends(file)[2]
    assert not coarse.times[begin:].any()
    assert 0 < whole.times[begin:].mean() < 0.7
    for at in np.flatnonzero(whole.times[begin:] == 0)[::2000] + begin:
        assert_same(decode_box(BytesSource(flipped(file, at, 1)), box), wanted)


def flipped(data, at, bits):
    return data[:at] + bytes([data[at] ^ bits]) + data[at + 1 :]


def test_details_behind_an_address(file, sorted_scene):
    box, wanted = corner_of(sorted_scene)
    with serve({"s.clgs": file, "cut.clgs": file[:-1]}) as url:
        assert_same(decode(url + "s.clgs"), sorted_scene)
        assert_same(decode(url + "s.clgs", layers=3), rounded(sorted_scene))
        assert_same(decode(url + "s.clgs", box=box), wanted)
        with pytest.warns(UserWarning, match="layers 1 to 3 of 4"):
            assert_same(decode(url + "cut.clgs"), rounded(sorted_scene))


@pytest.mark.parametrize(("most", "step"), [(2**30 - 1, 3), (2**30, 1), (2**31 - 1, 1)])
def test_integers_that_no_step_fits_are_not_divided(small, most, step):
    scene = replace(small, anchors=small.anchors.map(np.copy))
    scene.anchors.feature[:2, 0] = most, -most
    importance = np.ones(len(scene.anchors))
    data = encode(scene, "fast", 64, layers=2, importance=importance, details=True)
    assert int.from_bytes(contents(data)["DETL"][:4], "little") == step
    wanted = replace(scene, anchors=sort_anchors(scene.anchors))
    assert_same(decode(data), wanted)
    assert_same(decode(data, layers=1), rounded(wanted) if step == 3 else wanted)


def test_one_anchor_has_details(small):
    one = replace(small, anchors=take(small.anchors, slice(0, 1)))
    data = encode(one, layers=2, details=True)
    assert_same(decode(data), one)
    assert_same(decode(data, layers=1), rounded(one))
    assert [layer["anchors"] for layer in describe(data)["layers"]] == [1, 0]
    with pytest.raises(UsageError, match="there are 1"):
        encode(one, layers=3, details=True)


def test_one_layer_has_no_details(small):
    for layers in (None, 1):
        plain = encode(small, "fast", layers=layers)
        assert encode(small, "fast", layers=layers, details=True) == plain


@settings(max_examples=12)
@given(st.data())
def test_small_scenes_come_back(data):
    scene = random_scene(np.random.default_rng(data.draw(st.integers(0, 99))), 6)
    scene.mlps.flat[:] = 0
    for name in ("offset", "feature", "scaling"):
        rows = getattr(scene.anchors, name)
        wide = data.draw(st.sampled_from([INT32, st.integers(-5, 5)]))
        for value in data.draw(st.lists(wide, max_size=6)):
            rows.ravel()[data.draw(st.integers(0, rows.size - 1))] = value
    level = data.draw(st.sampled_from(["fast", "default", "paper"]))
    layers = data.draw(st.integers(2, 4))
    importance = np.arange(len(scene.anchors), dtype=np.float64)
    file = encode(scene, level, 16, 1, layers=layers, importance=importance, details=True)
    found = decode(file, 1)
    assert_same(found, replace(scene, anchors=sort_anchors(scene.anchors)))
    assert encode(found, level, 16, 1) == encode(scene, level, 16, 1)
    coarse = decode(file, 1, layers=layers - 1)
    for name, array in coarse.anchors.items():
        off = array.astype(np.int64) - getattr(found.anchors, name)
        assert np.abs(off).max() <= 1


@pytest.mark.filterwarnings("ignore:the file is cut")
def test_every_flipped_bit_is_seen_in_whole_files_and_in_what_is_read_of_cut_ones(rng):
    *_, second, last = ends(GOLD)
    assert last == len(GOLD)
    places = [*rng.integers(0, last, 60).tolist(), *range(second, last, 16)]
    for at in places:
        damaged = flipped(GOLD, at, 1 << int(rng.integers(8)))
        with pytest.raises(CodecError) as error:
            decode(damaged)
        assert "\n" not in str(error.value)
        with pytest.raises(CodecError):
            decode_box(BytesSource(damaged), EVERYWHERE)
        if at < second:
            with pytest.raises(CodecError):
                decode(damaged[:second])


def test_too_many_layers_are_counted_with_that_of_details(small):
    few = replace(small, anchors=take(small.anchors, slice(0, 3)))
    assert len(describe(encode(few, layers=4, details=True))["layers"]) == 4
    with pytest.raises(UsageError, match=r"^layers: 5; .* but the last, and there are 3$"):
        encode(few, layers=5, details=True)


def test_all_of_a_file_is_compared_with_its_hash_also_if_it_is_read_in_parts(file):
    meta = bytearray(contents(file)["META"])
    meta[144] ^= 1
    other = BytesSource(rebuilt(file, META=bytes(meta)))
    with pytest.raises(CodecError, match=r"META at byte .*: the decoded integers do not match"):
        decode_box(other, EVERYWHERE)
    assert len(decode_box(other, EVERYWHERE, layers=3).anchors) > 0
