"""What a run was trained on is what its scene is drawn for and scored on."""

import json
import re
import shutil
from pathlib import Path

import pytest
from PIL import Image

from clgs.arguments import byte_count, seconds
from clgs.cli.main import build_parser, main
from clgs.train.config import from_toml
from tests.small_scene import write_scene


@pytest.fixture(scope="module")
def half(tmp_path_factory):
    """Photos of 40 x 40 pixels, and a run on them at half their width."""
    folder = tmp_path_factory.mktemp("half")
    data = write_scene(folder / "data")
    words = ["train", data, "-o", folder / "run", "--steps", "2", "--downscale", "2"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("clgs.data.points.HULL_POINTS", 3000)  # for speed
        assert main([*map(str, words)]) == 0
    return folder


@pytest.fixture
def command(half, tmp_path, monkeypatch):
    """A command on the photos."""
    monkeypatch.setattr("clgs.data.points.HULL_POINTS", 3000)  # for speed
    shutil.copytree(half, tmp_path, dirs_exist_ok=True)
    data = tmp_path / "data"

    def run(name: str, *words: object) -> int:
        about = [] if name == "train" else ["--data", data]
        first = [data] if name == "train" else []
        return main([name, *map(str, [*first, *words, *about])])

    return run


def sizes(folder: Path) -> set[tuple[int, int]]:
    """The sizes of the pictures in a folder."""
    found = set()
    for path in folder.iterdir():
        with Image.open(path) as picture:
            found.add(picture.size)
    return found


@pytest.mark.slow
def test_the_largest_width_goes_with_a_run(command, tmp_path):
    run, drawn = tmp_path / "narrow", tmp_path / "drawn"
    assert command("train", "-o", run, "--steps", 2, "--max-size", 24) == 0
    config = from_toml((run / "config.toml").read_text())
    assert (config.downscale, config.max_size) == (0, 24)
    assert command("render", run, "-o", drawn) == 0
    assert sizes(drawn) == {(24, 24)}
    assert command("eval", run, "--json", tmp_path / "scores.json") == 0
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert scores["psnr"] == json.loads((run / "results.json").read_text())["psnr"]
    assert command("render", run, "-o", tmp_path / "larger", "--max-size", 0) == 0
    assert sizes(tmp_path / "larger") == {(40, 40)}


@pytest.mark.slow
def test_another_width_is_another_run(command, tmp_path, capsys):
    again = ("train", "-o", tmp_path / "run", "--steps", 2, "--resume")
    assert command(*again, "--downscale", 2) == 0
    capsys.readouterr()
    assert command(*again, "--max-size", 20) == 2
    assert "other settings" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["train", "eval", "render", "run"])
def test_photos_of_a_few_pixels_are_refused(name, tmp_path, refusal):
    said = refusal(2, name, tmp_path, "--max-size", "3", *(["-o", "x"] if name != "eval" else []))
    assert "--max-size: 3 is out of range; give a whole number" in said


def test_a_scene_alone_is_drawn_at_the_default_size(command, tmp_path, capsys):
    file = tmp_path / "scene.clgs"
    file.write_bytes((tmp_path / "run" / "scene.clgs").read_bytes())
    capsys.readouterr()
    assert command("render", file, "-o", tmp_path / "drawn") == 0
    assert "--max-size 1600 is assumed" in capsys.readouterr().err
    assert sizes(tmp_path / "drawn") == {(40, 40)}


def test_data_of_which_no_photo_is_known_are_used_with_a_warning(command, tmp_path, capsys):
    for split in ("train", "test"):
        document = tmp_path / "data" / f"transforms_{split}.json"
        (tmp_path / "data" / split).rename(tmp_path / "data" / f"new_{split}")
        document.write_text(document.read_text().replace(f"{split}/", f"new_{split}/"))
    capsys.readouterr()
    assert command("eval", tmp_path / "run", "--json", tmp_path / "scores.json") == 0
    assert "has none of the photos that the scene was trained with; if" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("800k", 800_000), ("40KB", 40_000), ("1.5 MB", 1_500_000)),
        *(("2MiB", 2**21), ("1e5", 100_000)),
        *(("200q", None), ("0", None), ("-5", None), ("inf", None), ("\u0665k", None)),
    ],
)
def test_sizes_are_taken_as_people_write_them(text, value):
    assert byte_count(text) == value
    if value:
        words = ["train", "data", "-o", "run", "--target-size", text]
        assert build_parser(["train"]).parse_args(words).target_size == value
        words = ["encode", "run", "-o", "x.clgs", "--target-size", text]
        assert build_parser(["encode"]).parse_args(words).target_size == value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("90", 90), ("90s", 90), ("5m", 300), ("5min", 300), ("5 min", 300), ("1h30m", 5400)),
        *(("1h30", 5400), ("1h 5m 3s", 3903), ("2m30", 150), ("1.5 hours", 5400), ("1e3", 1000)),
        *(("5x", None), ("m", None), ("", None), ("30m1h", None), ("-5m", None), ("\u0665m", None)),
    ],
)
def test_times_are_taken_as_people_write_them(text, value):
    assert seconds(text) == value


@pytest.mark.parametrize(
    "words",
    """run p -o x --time #m; run p -o x --steps #; train p -o x --steps #; train p -o x --lambda #
    train p -o x --target-size #k; train p -o x --set steps=#; encode r -o x --target-size #k
    encode r -o x --chunk #; encode r -o x --q 1,1,1,#; decode s -o x --box 0,0,0,1,1,#
    decode s -o x --threads #; export s -o x --steps #; render s -o x --fps #; view s --port #
    prepare p -o x --seed #; pack s -o x --step scale=#; render s -o x --size 9x#""".replace(
        "\n", ";"
    ).split(";"),
)
def test_digits_of_other_scripts_are_refused_with_the_reason(words, refusal):
    said = refusal(2, *words.replace("#", "\u0665").split())
    assert re.search("\u0665[km]? has digits other than 0 to 9; ", said)


@pytest.mark.parametrize(
    "words",
    [
        *("train p -o x --steps 1_000", "train p -o x --lambda 1_0"),
        *("train p -o x --set steps=1_000", "decode s -o x --box 0,0,0,1,1,1_0"),
        *("encode r -o x --q 1_00,1,1,8", "pack s -o x --step scale=1_0"),
    ],
)
def test_numbers_have_no_underscores(words, refusal):
    assert re.search(r"1_0+\b", refusal(2, *words.split()))


@pytest.mark.parametrize(
    ("words", "value"),
    [
        *(("train p -o x --steps 1e3", 1000), ("run p -o x --steps 1e3", 1000)),
        *(("prepare p -o x --frames 1e2", 100), ("encode r -o x --chunk 1e3", 1000)),
        *(("render s -o x --up -y", "-y"), ("render s -o x --up=-z", "-z")),
        ("encode r -o x --target-psnr -1e1", -10.0),
        ("train p -o x --loss-weights 1e-1 2", None),
    ],
)
def test_values_are_taken_as_people_write_them(words, value):
    command = words.split()[0]
    found = build_parser([command]).parse_args(words.split())
    name = next(word for word in words.split() if word[:2] == "--").partition("=")[0]
    shown = getattr(found, name[2:].replace("-", "_"))
    assert shown == ([0.1, 2.0] if value is None else value)


def test_a_size_of_no_known_unit_is_answered_by_examples(refusal):
    message = refusal(2, "train", "data", "-o", "run", "--target-size", "200q")
    assert "--target-size: '200q' is not a whole number" in message
    assert "such as 800k or 1.5M" in message
