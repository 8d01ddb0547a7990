"""`clgs encode --target-size` and `--target-psnr`: arguments, and a run without a dataset."""

import argparse
from dataclasses import replace

import numpy as np
import pytest

from clgs.cli.commands.encode import size
from clgs.cli.main import main
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode
from clgs.data.dataset import load_dataset
from clgs.data.origin import repose
from clgs.scene.camera import photo_range
from clgs.scene.storage import load_scene, save_scene
from tests.codec.scenes import random_scene
from tests.data.folders import write_transforms


@pytest.fixture
def scene(tmp_path, rng):
    """A file of a random scene."""
    save_scene(tmp_path / "s.npz", random_scene(rng, 2000))
    return str(tmp_path / "s.npz")


@pytest.fixture
def target(tmp_path):
    return tmp_path / "s.clgs"


def test_sizes():
    assert [size(text) for text in ("800k", "1.5M", "800000", "0.002G", "7K")] == [
        *(800_000, 1_500_000, 800_000, 2_000_000, 7_000)
    ]
    for text in ("", "k", "0", "-1k", "nan", "inf", "1T", "1kk", "1e30"):
        with pytest.raises(argparse.ArgumentTypeError):
            size(text)


def test_options_must_fit_each_other(scene, target, refusal):
    for options in (
        *("--target-psnr 30", "--data .", "--target-size 10", "--mlps x.npz", "--all-views"),
        *("--downscale 2", "--target-size 10k --max-size 60"),
    ):
        refusal(2, "encode", scene, "-o", target, *options.split())
    for options in ("--target-size 10k --target-psnr 3", "--target-psnr nan", "--q 1,2,3"):
        assert refusal(2, "encode", scene, "-o", target, *options.split()).startswith("--")
    assert not target.exists()


def test_without_a_dataset_the_cost_is_not_measured(scene, target, output_of):
    assert main(["encode", scene, "-o", str(target)]) == 0
    wanted = target.stat().st_size * 6 // 10
    shown = output_of("encode", scene, "-o", target, "--target-size", wanted, "--overwrite")
    assert 0.98 * wanted <= target.stat().st_size <= wanted
    assert "PSNR cost: not measured" in shown


@pytest.mark.parametrize("level", ["fast", "default"])
def test_the_same_file_every_time(scene, tmp_path, level):
    command = ["encode", scene, "--level", level, "--target-size", "50k"]
    for name, threads in (("a.clgs", "1"), ("b.clgs", "2")):
        assert main([*command, "--threads", threads, "-o", str(tmp_path / name)]) == 0
    first = (tmp_path / "a.clgs").read_bytes()
    assert first == (tmp_path / "b.clgs").read_bytes()
    assert 0.98 * 50_000 <= len(first) <= 50_000


def test_a_size_that_cannot_be_reached_is_one_line(scene, target, refusal):
    said = refusal(2, "encode", scene, "-o", target, "--target-size", "50")
    assert said.startswith("a file of 50 bytes is too small: ")
    assert not target.exists()


def test_an_interrupted_run_leaves_nothing(scene, target, tmp_path, monkeypatch):
    target.write_bytes(b"before")
    trials: list[int] = []

    def interrupted(*arguments: object, **_: object) -> bytes:
        trials.append(1)
        if len(trials) == 3:
            raise KeyboardInterrupt
        return encode(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr("clgs.codec.scene_encoder.encode", interrupted)
    command = ["encode", scene, "-o", str(target), "--target-size", "60k", "--overwrite"]
    assert main(command) == 130
    assert len(trials) == 3
    assert target.read_bytes() == b"before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.clgs", "s.npz"]


def test_an_older_file_learns_of_its_photos(scene, target, tmp_path, refusal):
    data = tmp_path / "data"
    write_transforms(data, 16)
    command = ["encode", scene, "-o", str(target), "--data", str(data), "--downscale", "2"]
    assert main(command) == 0
    found = decode(target.read_bytes())
    shown = repose(load_dataset(data, downscale=2, load_images=False), found.transform)
    assert found.settings.photos == photo_range([view.camera for view in shown.train])
    old = encode(load_scene(scene))
    assert describe(target.read_bytes())["content_hash"] == describe(old)["content_hash"]
    command[1:4] = [str(target), "-o", str(tmp_path / "again.clgs")]
    assert main([*command, "--layers", "2"]) == 0
    assert decode((tmp_path / "again.clgs").read_bytes()).settings == found.settings
    assert main([*command[:-1], "1", "--overwrite"]) == 0  # it was another size
    again = decode((tmp_path / "again.clgs").read_bytes()).settings.photos
    assert again.least_focal == pytest.approx(2 * found.settings.photos.least_focal)
    said = refusal(2, *command[:-2], "--overwrite")
    assert "give --downscale N or --max-size N as it was trained with" in said
    gone = ["--data", str(data / "x"), "--downscale", "1"]
    said = refusal(3, "encode", scene, "-o", tmp_path / "no.clgs", *gone)
    assert said.endswith("x: no such folder; check the path\n")
    assert not (tmp_path / "no.clgs").exists()


def test_the_last_of_three_layers_is_the_precision_of_all_anchors(tmp_path, rng, target):
    fine = random_scene(rng, 2000)
    fine.scales = replace(fine.scales, feature=3.0)
    save_scene(tmp_path / "s.npz", fine)
    scene = str(tmp_path / "s.npz")
    assert main(["encode", scene, "-o", str(target), "--layers", "3"]) == 0
    data = target.read_bytes()
    whole, coarse = decode(data), decode(data, layers=2)
    assert [layer["anchors"] > 0 for layer in describe(data)["layers"]] == [True, True, False]
    assert describe(data)["content_hash"] == describe(encode(load_scene(scene)))["content_hash"]
    np.testing.assert_array_equal(coarse.anchors.position, whole.anchors.position)
    np.testing.assert_array_equal(coarse.anchors.feature % 3, 0)
    assert abs(coarse.anchors.feature - whole.anchors.feature).max() == 1
    for layers in ("1", "2"):  # so few would begin with more than half of the file
        assert main(["encode", scene, "-o", str(target), "--layers", layers, "--overwrite"]) == 0
        assert describe(target.read_bytes())["version"] == "1.2"


def test_coarse_features_are_not_made_coarser_by_layers(tmp_path, rng, target):
    coarse = random_scene(rng, 2000)
    coarse.scales = replace(coarse.scales, feature=2.9)
    save_scene(tmp_path / "s.npz", coarse)
    assert main(["encode", str(tmp_path / "s.npz"), "-o", str(target), "--layers", "3"]) == 0
    assert all(layer["anchors"] > 0 for layer in describe(target.read_bytes())["layers"])


@pytest.mark.slow
def test_photos_of_a_dataset_say_what_it_costs(scene, target, tmp_path, open_device, output_of):
    write_transforms(tmp_path / "data", 16)
    command = ["encode", scene, "-o", str(target), "--data", str(tmp_path / "data")]
    command += ["--target-size", "50k", "--downscale", "1", "--device", open_device("cpu").name]
    assert "PSNR on 12 of 14 training views: " in output_of(*command)
    assert 0.98 * 50_000 <= target.stat().st_size <= 50_000
    assert "PSNR on 14 of 14 training views: " in output_of(*command, "--all-views", "--overwrite")
