"""The page as text: its size, that it loads nothing, where it starts, and the command."""

import base64
import json
import re

import numpy as np
import pytest

from clgs.cli import main as cli
from clgs.codec.scene_decoder import decode
from clgs.codec.scene_encoder import encode
from clgs.errors import ClgsError
from clgs.exports import page
from clgs.lab.scenes import camera_of
from tests.small_scene import write_scene
from tests.web.scenes import quantized_scene

OTHER_BYTES = 150_000
"""What a page may take in addition to 1.4 times its scene."""


@pytest.fixture(scope="module")
def data():
    return encode(quantized_scene(2000, 32)[0])


@pytest.fixture
def decoder(monkeypatch):
    """The page's decoder, or words in its place: these tests do not run it."""
    try:
        page._decoder()
    except ClgsError:
        monkeypatch.setattr(page, "_decoder", lambda: b"\0asm")


def part(text, name):
    return re.search(rf'id="{name}">(.*?)</script>', text, flags=re.S)[1].strip()


def test_a_page_holds_its_scene_and_little_else(decoder, data):
    whole = page.scene_page(data, "a </script> & b")
    assert len(whole) <= 1.4 * len(data) + OTHER_BYTES
    text = whole.decode()
    assert base64.b64decode(part(text, "scene")) == data
    assert "<title>a &lt;/script&gt; &amp; b</title>" in text
    assert json.loads(part(text, "settings"))["title"] == "a </script> & b"
    assert "{{" not in text


def test_a_page_loads_nothing(decoder, data):
    text = page.scene_page(data, "scene").decode()
    assert not re.search(r"https?:|\bsrc=|\bhref=|@import|import\(|importScripts|fetch\(", text)


def test_a_start_looks_where_the_cameras_look():
    first = camera_of(40, 40)  # 4 before the origin
    start = page.start_at(first, [first, turned(1.0), turned(-1.0)])
    np.testing.assert_allclose(start.eye, [0, 0, -4], atol=1e-6)
    np.testing.assert_allclose(start.target, [0, 0, 0], atol=1e-4)
    np.testing.assert_allclose(start.up, [0, -1, 0], atol=1e-6)
    assert start.fov == pytest.approx(2 * np.arctan(0.5))


def turned(angle):
    """The same camera, turned around the origin."""
    from dataclasses import replace

    turn = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    return replace(camera_of(40, 40), rotation=np.array(turn))


def test_the_command_writes_a_page(decoder, data, tmp_path, capsys, refusal):
    scene, output = tmp_path / "scene.clgs", tmp_path / "scene.html"
    scene.write_bytes(data)
    photos = write_scene(tmp_path / "photos", train=3, test=1)
    command = ["export", str(scene), "-o", str(output)]
    assert cli.main([*command, "--data", str(photos)]) == 0
    size = output.stat().st_size
    said = f"{output}: {size:,} bytes, {len(data):,} of them the scene\n"
    assert capsys.readouterr().out == said
    start = json.loads(part(output.read_text(), "settings"))["start"]
    np.testing.assert_allclose(start["target"], 0, atol=1e-3)
    assert "exists already" in refusal(2, *command)
    run = tmp_path / "run"
    run.mkdir()
    scene.rename(run / "scene.clgs")
    assert cli.main(["export", str(run), "-o", str(output), "--overwrite"]) == 0


def test_the_command_writes_a_viewer(decoder, tmp_path):
    output = tmp_path / "viewer.html"
    assert cli.main(["export", "--viewer", "-o", str(output)]) == 0
    assert part(output.read_text(), "scene") == ""


def test_what_cannot_become_a_page_is_one_line(decoder, data, tmp_path, refusal):
    output = tmp_path / "out.html"
    (tmp_path / "cut.clgs").write_bytes(data[:-1])
    cases = [
        ([], 2, "name a SCENE, or give --viewer"),
        ([str(tmp_path / "cut.clgs"), "--viewer"], 2, "--viewer makes a page without a scene"),
        ([str(tmp_path / "cut.clgs")], 3, "cut.clgs: "),
        ([str(tmp_path / "none.clgs")], 3, "no such file"),
        ([str(tmp_path)], 3, "is a folder"),
    ]
    for words, code, said in cases:
        assert said in refusal(code, "export", *words, "-o", output)
    assert not output.exists()


def test_a_build_without_the_decoder_says_so(monkeypatch, data, tmp_path, capsys):
    monkeypatch.setattr(page.importlib.resources, "files", lambda name: tmp_path)
    with pytest.raises(ClgsError, match="install clang with lld"):
        page._decoder()


def test_a_page_of_a_file_in_layers_holds_it_without_them(decoder, data, tmp_path):
    file, output = tmp_path / "s.clgs", tmp_path / "s.html"
    file.write_bytes(encode(decode(data), layers=3))
    assert cli.main(["export", str(file), "-o", str(output)]) == 0
    assert base64.b64decode(part(output.read_text(), "scene")) == data


def test_a_page_with_a_link_holds_no_scene(decoder, data, tmp_path, capsys):
    scene, output = tmp_path / "scene.clgs", tmp_path / "scene.html"
    scene.write_bytes(data)
    photos = write_scene(tmp_path / "photos", train=3, test=1)
    command = ["export", str(scene), "-o", str(output), "--link", "files/a b.clgs"]
    assert cli.main([*command, "--data", str(photos)]) == 0
    text = output.read_text()
    assert capsys.readouterr().out == f"{output}: {len(text.encode()):,} bytes\n"
    assert part(text, "scene") == ""
    settings = json.loads(part(text, "settings"))
    assert settings["address"] == "files/a b.clgs"
    assert settings["start"]["eye"]
    assert "fetch(" in part(text, "worker")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["-o", "a.ply", "--link", "x"], "a.ply: only a page has a link"),
        (["-o", "a.html", "--link", ""], "link: is empty"),
        (["-o", "a.html", "--link", "file:///a/x.clgs"], "a page cannot read file:///a/x.clgs; "),
        (["-o", "a.html", "--link", r"C:\a\x.clgs"], r"a page cannot read C:\a\x.clgs; give http"),
        (["-o", "a.html", "--link", "x", "--steps", "3"], "--steps: has no effect with --link"),
    ],
)
def test_a_link_that_is_none_is_refused(data, tmp_path, monkeypatch, refusal, more, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.clgs").write_bytes(data)
    assert said in refusal(2, "export", "scene.clgs", *more)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.clgs"]
