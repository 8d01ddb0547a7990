"""`clgs encode --target-size` and `--target-psnr`: arguments, and a run without a dataset."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from clgs.cli.encode_target import size
from clgs.cli.main import main
from clgs.scene.storage import save_scene
from tests.codec.scenes import random_scene


def test_sizes() -> None:
    assert [size(text) for text in ("800k", "1.5M", "800000", "0.002G", "7K")] == [
        *(800_000, 1_500_000, 800_000, 2_000_000, 7_000)
    ]
    for text in ("", "k", "0", "-1k", "nan", "inf", "1T", "1kk", "1e30"):
        with pytest.raises(argparse.ArgumentTypeError):
            size(text)


def test_options_must_fit_each_other(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, target = str(tmp_path / "s.npz"), str(tmp_path / "s.clgs")
    save_scene(Path(scene), random_scene(rng))
    for options in (
        ["--target-psnr", "30"],
        ["--data", "."],
        ["--target-size", "10"],
        ["--mlps", "x.npz"],
    ):
        assert main(["encode", scene, "-o", target, *options]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    for options in (
        ["--target-size", "10k", "--target-psnr", "3"],
        ["--target-psnr", "nan"],
        ["--target-size", "much"],
        ["--q", "1,2,3"],
    ):
        with pytest.raises(SystemExit) as error:
            main(["encode", scene, "-o", target, *options])
        assert error.value.code == 2
        said = capsys.readouterr().err
        assert said.startswith("clgs: error: --")
        assert said.count("\n") == 1
    assert not Path(target).exists()


def test_without_a_dataset_the_cost_is_not_measured(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, target = tmp_path / "s.npz", tmp_path / "s.clgs"
    save_scene(scene, random_scene(rng, 2000))
    assert main(["encode", str(scene), "-o", str(target)]) == 0
    wanted = target.stat().st_size * 6 // 10
    capsys.readouterr()
    assert main(["encode", str(scene), "-o", str(target), "--target-size", str(wanted)]) == 0
    assert 0.98 * wanted <= target.stat().st_size <= wanted
    assert "PSNR cost: not measured" in capsys.readouterr().out
