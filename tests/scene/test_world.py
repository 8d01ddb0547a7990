"""What a scene's world is stays with it: as text, in archives and bitstreams, in exported files."""

from __future__ import annotations

import json
import struct
import zipfile
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest

from clgs.cli.main import main
from clgs.codec.meta import pack_geor, unpack_geor
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode
from clgs.data.splats.anchors import load_scaffold, save_scaffold
from clgs.data.splats.gaussians import load_splats
from clgs.data.splats.integer_splats import read_splats
from clgs.errors import CodecError
from clgs.exports.glb import encode_glb
from clgs.exports.splats.ply import encode_ply
from clgs.exports.splats.sog import encode_sog
from clgs.exports.splats.spz import encode_spz
from clgs.scene.scene import QuantizedScene, SceneTransform
from clgs.scene.storage import load_scene, save_scene
from clgs.scene.world import EARTH, LOCAL, MAP, METRES, NOWHERE, from_text, in_words, to_text
from clgs.workflow.export import export
from codec_c.reader.files import read_file
from tests.codec.container.damage import contents, rebuilt
from tests.codec.scenes import random_scene
from tests.exports.splats.cases import gaussians

PLACE = 46.94811234567891, -7.447412345678912, 553.2512345678
WORLDS = [(METRES, NOWHERE), (EARTH, PLACE), (MAP, NOWHERE)]
CENTRE = 602_123.512345678, 5_200_321.25, 431.0


def scene_in(frame: int, place: tuple[float, float, float]) -> QuantizedScene:
    """A scene in a world; the transform has digits that float32 cannot hold."""
    transform = SceneTransform(CENTRE, 0.123456789012345, frame, place)
    return replace(random_scene(np.random.default_rng(1)), transform=transform)


@pytest.mark.parametrize(("frame", "place"), [(LOCAL, NOWHERE), *WORLDS])
def test_text_comes_back(frame, place):
    assert from_text(["other", to_text(frame, place)]) == (frame, place)


def test_texts_that_are_none_are_local():
    lines = ["world: moon", "world: earth", "world: earth 91 0 0"]
    lines += ["world: earth a b c", "world: earth nan 0 0", "world: earth 1 2", "world"]
    assert from_text(lines) == (LOCAL, NOWHERE)
    assert from_text([*lines, "world: map"]) == (MAP, NOWHERE)


@pytest.mark.slow
@pytest.mark.parametrize(("frame", "place"), WORLDS)
def test_bitstreams_and_archives_keep_it_to_the_last_bit(tmp_path, frame, place):
    scene = scene_in(frame, place)
    data = encode(scene)
    assert decode(data).transform == scene.transform
    found = describe(data)
    assert (found["version"], found["sections"]["GEOR"]) == ("1.1", 32)
    assert found["world"] == in_words(frame, place)
    assert SceneTransform(**found["transform"]) == scene.transform
    assert read_file(data).meta.centre == CENTRE  # the reader made from FORMAT.md passes it over
    save_scene(tmp_path / "scene.npz", scene)
    assert load_scene(tmp_path / "scene.npz").transform == scene.transform
    save_scaffold(tmp_path / "scene.ply", scene)
    assert load_scaffold(tmp_path / "scene.ply").transform == scene.transform


def test_local_scenes_are_written_as_ever(tmp_path):
    scene = scene_in(LOCAL, NOWHERE)
    data = encode(scene)
    found = describe(data)
    assert (found["version"], found["world"]) == ("1.0", "local, units of its own")
    assert "GEOR" not in found["sections"]
    save_scene(tmp_path / "scene.npz", scene)
    with np.load(tmp_path / "scene.npz") as archive:
        assert "transform.frame" not in archive.files
    assert load_scene(tmp_path / "scene.npz").transform == scene.transform


@pytest.mark.slow
@pytest.mark.parametrize(
    "bad",
    [
        b"",
        pack_geor(EARTH, PLACE) + b"\0",
        pack_geor(LOCAL, NOWHERE),
        struct.pack("<II3d", 9, 0, *NOWHERE),
        struct.pack("<II3d", METRES, 1, *NOWHERE),
        pack_geor(METRES, PLACE),
        pack_geor(EARTH, (90.5, 0.0, 0.0)),
        pack_geor(EARTH, (0.0, float("nan"), 0.0)),
        pack_geor(EARTH, (0.0, 0.0, float("inf"))),
    ],
)
def test_damaged_sections_are_refused(bad):
    with pytest.raises(ValueError, match=r"instead of 32|out of range"):
        unpack_geor(bad)
    data = encode(scene_in(EARTH, PLACE))
    assert describe(rebuilt(data, GEOR=pack_geor(MAP, NOWHERE)))["transform"]["frame"] == MAP
    with pytest.raises(CodecError, match="section GEOR at byte"):
        decode(rebuilt(data, GEOR=bad))
    assert "GEOR" not in contents(data)


@pytest.mark.parametrize(("frame", "place"), WORLDS)
def test_exported_files_say_it(tmp_path, capsys, frame, place):
    transform = SceneTransform((1.0, 2.0, 3.0), 2.0, frame, place)
    splats = gaussians(0)
    for encoded, name in ((encode_ply, "x.ply"), (encode_sog, "x.sog")):
        path = tmp_path / name
        path.write_bytes(encoded(splats, transform).data)
        found = load_splats(path)
        assert (found.transform.frame, found.transform.place) == (frame, place)
        assert np.abs(found.gaussians.mean - transform.to_world(splats.mean)).max() < 0.01
        assert main(["info", str(path), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["world"] == in_words(frame, place)
    data = encode_glb(splats, transform).data
    header = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    assert header["asset"]["extras"] == {"world": to_text(frame, place)}
    again = tmp_path / "again.sog"
    export(tmp_path / "x.ply", again)
    assert load_splats(again).transform.place == place
    with zipfile.ZipFile(BytesIO(again.read_bytes())) as archive:
        assert json.loads(archive.read("meta.json"))["asset"]["world"] == to_text(frame, place)


def test_spz_says_that_it_cannot_hold_the_place(tmp_path):
    transform = SceneTransform(frame=EARTH, place=PLACE)
    (tmp_path / "x.ply").write_bytes(encode_ply(gaussians(0), transform).data)
    notes = []
    export(tmp_path / "x.ply", tmp_path / "x.spz", on_event=notes.append)
    assert any("does not hold where its origin is: world: metres" in str(note) for note in notes)
    notes.clear()
    export(tmp_path / "x.ply", tmp_path / "y.spz", units="scene", on_event=notes.append)
    assert not notes
    assert encode_spz(gaussians(0), transform).data == encode_spz(gaussians(0)).data


def test_pack_says_that_packed_splats_cannot_hold_the_place(tmp_path, caplog):
    for frame, place in WORLDS:
        path = tmp_path / "x.ply"
        path.write_bytes(encode_ply(gaussians(0), SceneTransform(frame=frame, place=place)).data)
        read_splats(path, {})
        said = "packed splats do not hold where their origin is: world: metres" in caplog.text
        assert said == (frame == EARTH)
        caplog.clear()


def test_without_a_world_nothing_is_added():
    for encoder in (encode_ply, encode_sog, encode_glb):
        assert b"world" not in encoder(gaussians(0)).data
