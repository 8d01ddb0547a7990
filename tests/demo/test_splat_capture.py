"""Photographs of splats are a Blender capture, with alpha, and upright."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clgs.data.dataset import load_dataset
from clgs.data.splats.ply import PlyTable, pack_ply

COUNT = 400
BRIGHT = 1.0
"""Its harmonic of degree 0: red at positive y, green at negative y."""


@pytest.mark.slow
@pytest.mark.parametrize("up", ["y", "-y"])
def test_the_end_that_is_up_is_above(tmp_path: Path, monkeypatch, rng, up):
    import splat_capture

    x, y, z = rng.uniform(-1, 1, (3, COUNT)).astype(np.float32)
    columns = {"x": x, "y": y, "z": z, "opacity": np.full(COUNT, 4, np.float32)}
    columns |= {f"scale_{axis}": np.full(COUNT, -3, np.float32) for axis in range(3)}
    columns |= {f"rot_{axis}": np.full(COUNT, axis == 0, np.float32) for axis in range(4)}
    for channel, side in enumerate((y > 0, y < 0, y > 9)):
        columns[f"f_dc_{channel}"] = np.where(side, BRIGHT, -BRIGHT).astype(np.float32)
    (tmp_path / "s.ply").write_bytes(pack_ply(PlyTable(columns)))
    monkeypatch.setattr(splat_capture, "VIEWS", {"train": 3, "test": 1})
    assert splat_capture.main([str(tmp_path / "s.ply"), str(tmp_path / "data"), up]) == 0
    dataset = load_dataset(tmp_path / "data")
    assert (dataset.kind, len(dataset.train), len(dataset.test)) == ("blender", 3, 1)
    pixels = np.asarray(Image.open(tmp_path / "data" / "train" / "r_0.png"), np.float64)
    assert pixels[..., 3].min() == 0
    assert pixels[..., 3].max() > 250
    red, green = (pixels[..., channel] * pixels[..., 3] for channel in (0, 1))
    upper = red - green if up == "y" else green - red
    middle = len(pixels) // 2
    assert upper[:middle].sum() > 0 > upper[middle:].sum()


@pytest.mark.parametrize("words", [[], ["a"], ["a", "b", "z"]])
def test_wrong_words_are_refused(words, capsys):
    import splat_capture

    assert splat_capture.main(words) == 2
    assert "usage" in capsys.readouterr().err


def test_what_cannot_be_read_or_is_there_is_named(tmp_path: Path, capsys):
    import splat_capture

    assert splat_capture.main([str(tmp_path / "none.ply"), str(tmp_path / "new")]) == 3
    assert splat_capture.main(["a.ply", str(tmp_path)]) == 3
    assert "none.ply: no such file" in (said := capsys.readouterr().err)
    assert "choose a new folder" in said
    assert not (tmp_path / "new").exists()
