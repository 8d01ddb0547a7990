"""Scenes behind an address: what is asked for, and what servers do wrong."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.codec.http_source import FRONT, HttpSource
from clgs.codec.scene_decoder import decode, decode_box, describe
from clgs.codec.scene_encoder import encode
from clgs.errors import DataError
from clgs.scene.region import Box
from tests.codec.container.range_server import CLAIMED, serve
from tests.codec.scenes import assert_same, random_scene


@pytest.fixture(scope="module")
def data():
    """More bytes than a first request asks for."""
    data = encode(random_scene(np.random.default_rng(5), 3000), "fast", 64, layers=3)
    assert len(data) > 1.5 * FRONT
    return data


@pytest.mark.slow
def test_a_scene_its_layers_and_a_box_of_it(data):
    box = Box((-np.inf,) * 3, (-0.02, np.inf, np.inf))
    with serve({"s.clgs": data, "plain.clgs": encode(decode(data))}) as url:
        assert_same(decode(url + "s.clgs"), decode(data))
        assert_same(decode(url + "plain.clgs"), decode(data))
        assert_same(decode(url + "s.clgs", layers=2), decode(data, layers=2))
        assert_same(decode(url + "s.clgs", box=box), decode(data, box=box))
        source = HttpSource(url + "s.clgs")
        part = decode_box(source, box)
        source.close()
    assert 0 < len(part.anchors) < len(decode(data).anchors)
    assert source.bytes_read < len(data)


def test_a_file_that_is_cut_at_the_server_is_a_coarser_scene(data):
    second = describe(data)["layers"][1]["end"]
    cut = pytest.warns(UserWarning, match="layers 1 to 2 of 3")
    with serve({"s.clgs": data[: second + 5]}) as url, cut:
        assert_same(decode(url + "s.clgs"), decode(data, layers=2))


@pytest.mark.parametrize("details", [False, True])
def test_what_has_come_before_a_connection_breaks_is_a_coarser_scene(details):
    scene = random_scene(np.random.default_rng(5), 3000)
    data = encode(scene, "fast", 64, layers=4, details=details)
    ends = [layer["end"] for layer in describe(data)["layers"]]
    assert ends[1] < FRONT < ends[2]
    box = Box((-np.inf,) * 3, (-0.02, np.inf, np.inf))
    for there, come in ((2, FRONT + 9), (3, FRONT + ends[2] - ends[1] + 9)):
        said = rf"try again; it has layers 1 to {there} of 4, a coarser scene"
        with serve({"s.clgs": data}, limit=come) as url, pytest.warns(UserWarning, match=said):
            assert_same(decode(url + "s.clgs"), decode(data, layers=there))
    cut = pytest.warns(UserWarning, match="layers 1 to 2 of 4")
    with serve({"s.clgs": data}, limit=FRONT + 9) as url, cut:
        assert_same(decode(url + "s.clgs", box=box), decode(data, layers=2, box=box))
    with serve({"s.clgs": data}, limit=FRONT) as url:
        assert_same(decode(url + "s.clgs", layers=1), decode(data, layers=1))
    cut = pytest.warns(UserWarning, match="layer 1 of 4")
    with serve({"s.clgs": data}, limit=(ends[0] + ends[1]) // 2) as url, cut:  # in the first answer
        assert_same(decode(url + "s.clgs"), decode(data, layers=1))
    cut = pytest.warns(UserWarning, match="says 503; try again; it has layers 1 to 2 of 4")
    with serve({"s.clgs": data}, limit=FRONT, way="failing") as url, cut:
        assert_same(decode(url + "s.clgs"), decode(data, layers=2))
    with serve({"s.clgs": data}, limit=1000) as url, pytest.raises(DataError, match="try again"):
        decode(url + "s.clgs")


def test_addresses_may_have_blanks_and_letters_of_all_alphabets(data):
    with serve({"%C3%BC%20b%20.clgs?x=%C3%BC": data}) as url:
        for address in ("ü b .clgs?x=ü", "%C3%BC%20b%20.clgs?x=%C3%BC"):
            assert_same(decode(url + address), decode(data))


def test_servers_and_addresses_that_do_not_serve(data):
    with serve({"s.clgs": data}, ranges=False) as url:
        for name, said in (
            ("s.clgs", "the server ignores ranges; download the file"),
            ("none.clgs", "the server says 404"),
            ("moved", "the file has moved to file:///etc/passwd; name that address"),
        ):
            with pytest.raises(DataError, match=said) as error:
                decode(url + name)
            assert str(error.value).startswith(url + name)
            assert "\n" not in str(error.value)
    with pytest.raises(DataError, match="not read"):
        decode(url + "s.clgs")  # the server is gone
    wrong = ("file:///etc/passwd", "ftp://host/x.clgs", "http://", "http://[::1/x", "http://a\0b/x")
    for address in (*wrong, url + "s.clgs\r\nX: y"):
        with pytest.raises(DataError) as error:
            decode(address)
        assert "\n" not in str(error.value)
    with pytest.raises(TypeError, match="bytes are needed"):
        decode("scene.clgs")


@pytest.mark.slow
@pytest.mark.parametrize("way", ["pieces", "leaving"])
def test_answers_in_pieces_and_connections_that_end_serve(data, way):
    box = Box((-np.inf,) * 3, (-0.02, np.inf, np.inf))
    with serve({"s.clgs": data}, way=way) as url:
        assert_same(decode(url + "s.clgs"), decode(data))
        assert_same(decode(url + "s.clgs", box=box), decode(data, box=box))


@pytest.mark.parametrize(
    ("way", "said"),
    [
        ("long", "not as long as"),
        ("packed", "packs"),
        ("unknown", "does not say how long the file is; download the file"),
    ],
)
def test_answers_that_are_not_their_range_are_named(data, way, said):
    with serve({"s.clgs": data}, way=way) as url, pytest.raises(DataError, match=said):
        decode(url + "s.clgs")


def test_a_length_that_is_only_claimed_takes_no_memory(data):
    with serve({"s.clgs": data}, way="huge") as url:
        source = HttpSource(url + "s.clgs")
        with pytest.raises(DataError, match="the answer is cut; try again"):
            source.read(FRONT, CLAIMED - FRONT)


def test_a_box_is_a_box(data):
    with pytest.raises(TypeError, match=r"box: is tuple, give a clgs\.scene\.region\.Box"):
        decode(data, box=(0, 0, 0, 1, 1, 1))
