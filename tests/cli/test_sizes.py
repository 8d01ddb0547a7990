"""What a run was trained on is what its scene is drawn for and scored on."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from clgs.cli.main import main
from clgs.train.config import from_toml
from tests.small_scene import write_scene


@pytest.fixture
def command(
    tmp_path: Path, open_device: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., int]:
    """A command on photos of 40 x 40 pixels."""
    monkeypatch.setattr("clgs.data.points.HULL_POINTS", 3000)  # for speed
    data, device = write_scene(tmp_path / "data"), open_device("cpu").name

    def run(name: str, *words: object) -> int:
        about = [] if name == "train" else ["--data", data]
        first = [data] if name == "train" else []
        return main([name, *map(str, [*first, *words, *about, "--device", device])])

    return run


def test_the_largest_width_goes_with_a_run(command, tmp_path: Path):
    run, drawn = tmp_path / "run", tmp_path / "drawn"
    assert command("train", "-o", run, "--steps", 2, "--max-size", 24) == 0
    config = from_toml((run / "config.toml").read_text())
    assert (config.downscale, config.max_size) == (0, 24)
    assert command("render", run, "-o", drawn) == 0
    assert {Image.open(path).size for path in drawn.iterdir()} == {(24, 24)}
    assert command("eval", run, "--json", tmp_path / "scores.json") == 0
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert scores["psnr"] == json.loads((run / "results.json").read_text())["psnr"]
    assert command("render", run, "-o", tmp_path / "larger", "--max-size", 0) == 0
    assert Image.open(next((tmp_path / "larger").iterdir())).size == (40, 40)


def test_another_width_is_another_run(command, tmp_path: Path, capsys):
    run = tmp_path / "run"
    assert command("train", "-o", run, "--steps", 2, "--downscale", 2) == 0
    again = ("train", "-o", run, "--steps", 2, "--resume")
    assert command(*again, "--downscale", 2) == 0
    capsys.readouterr()
    assert command(*again, "--max-size", 20) == 2
    assert "other settings" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["train", "eval", "render", "run"])
def test_photos_of_a_few_pixels_are_refused(name: str, tmp_path: Path, capsys):
    with pytest.raises(SystemExit) as caught:
        main([name, str(tmp_path), "--max-size", "3", *(["-o", "x"] if name != "eval" else [])])
    assert caught.value.code == 2
    assert "--max-size: 3 is out of range; give a whole number" in capsys.readouterr().err


def test_a_scene_alone_is_drawn_at_the_default_size(command, tmp_path: Path, capsys):
    assert command("train", "-o", tmp_path / "run", "--steps", 1, "--downscale", 2) == 0
    file = tmp_path / "scene.clgs"
    file.write_bytes((tmp_path / "run" / "scene.clgs").read_bytes())
    capsys.readouterr()
    assert command("render", file, "-o", tmp_path / "drawn") == 0
    assert "--max-size 1600 is assumed" in capsys.readouterr().err
    assert Image.open(next((tmp_path / "drawn").iterdir())).size == (40, 40)


def test_data_of_which_no_photo_is_known_are_used_with_a_warning(command, tmp_path: Path, capsys):
    assert command("train", "-o", tmp_path / "run", "--steps", 1, "--downscale", 2) == 0
    for split in ("train", "test"):
        document = tmp_path / "data" / f"transforms_{split}.json"
        (tmp_path / "data" / split).rename(tmp_path / "data" / f"new_{split}")
        document.write_text(document.read_text().replace(f"{split}/", f"new_{split}/"))
    capsys.readouterr()
    assert command("eval", tmp_path / "run", "--json", tmp_path / "scores.json") == 0
    assert "has none of the photos that the scene was trained with; if" in capsys.readouterr().err


def test_a_size_of_no_known_unit_is_answered_by_examples(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["train", "data", "-o", "run", "--target-size", "200q"])
    message = capsys.readouterr().err
    assert "--target-size: '200q' is not a whole number" in message
    assert "such as 800k or 1.5M" in message
