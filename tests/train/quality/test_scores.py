"""PSNR and SSIM as papers report them, and scores in the files that other scripts read."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from clgs.constants import K_OFFSETS
from clgs.errors import ClgsError, UsageError
from clgs.lab.scenes import anchor_scene
from clgs.render.frame import upload_scene, upload_view
from clgs.render.rasterise import rasterise
from clgs.scene.anchors import QuantizationScales, quantize
from clgs.scene.scene import QuantizedScene
from clgs.train.quality.scores import (
    HEADER,
    ViewScore,
    append_survey,
    check_survey,
    count_drawn,
    psnr_8bit,
    psnr_channel_mean,
    ssim,
    ssim_map,
    summarize,
    to_8bit,
    write_inria,
)
from tests.codec.scenes import random_scene


def pictures(
    height: int = 40, width: int = 50, seed: int = 0
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """A smooth picture and a noisy copy, (H, W, 3) uint8."""
    rng = np.random.default_rng(seed)
    y, x = np.arange(height)[:, None, None], np.arange(width)[:, None]
    smooth = 127 + 90 * np.sin(0.2 * x + np.arange(3)) * np.cos(0.15 * y)
    noisy = smooth + rng.normal(0, 12, (height, width, 3))
    return smooth.astype(np.uint8), np.clip(noisy, 0, 255).astype(np.uint8)


def test_psnr_is_one_mse_over_all_channels():
    render, photo = np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2, 3), np.uint8)
    render[0, 0] = [51, 0, 0]  # 0.2 of white in one of 12 values
    assert psnr_8bit(render, photo) == pytest.approx(-10 * math.log10(0.04 / 12))
    render, photo = pictures()
    assert psnr_8bit(render, photo) == pytest.approx(peak_signal_noise_ratio(photo, render))


def test_equal_pictures_have_infinite_psnr_and_ssim_one():
    render, _ = pictures()
    assert psnr_8bit(render, render.copy()) == math.inf
    assert ssim(render, render.copy()) == pytest.approx(1.0, abs=1e-12)


def test_channel_mean_by_hand_and_unclamped():
    photo = np.zeros((2, 2, 3), np.uint8)
    photo[...] = [0, 255, 255]
    render = np.zeros((3, 2, 2), np.float32)
    render[0], render[1], render[2] = 0.1, 1.5, 0.9  # errors 0.1, 0.5 (beyond white), 0.1
    expected = (20 + -20 * math.log10(0.5) + 20) / 3
    assert psnr_channel_mean(render, photo) == pytest.approx(expected, rel=1e-6)


def test_channel_mean_is_never_below_the_pooled_psnr():
    render, photo = pictures()
    planar = (render / 255.0).transpose(2, 0, 1)
    assert psnr_channel_mean(planar, photo) >= psnr_8bit(render, photo) - 1e-9
    grey = np.repeat(render[..., :1], 3, axis=2), np.repeat(photo[..., :1], 3, axis=2)
    pooled = psnr_8bit(*grey)
    assert psnr_channel_mean((grey[0] / 255.0).transpose(2, 0, 1), grey[1]) == pytest.approx(pooled)


@pytest.mark.parametrize("seed", range(3))
def test_ssim_map_agrees_with_scikit_image_away_from_the_border(seed):
    render, photo = pictures(seed=seed)
    _, expected = structural_similarity(
        render / 255.0,
        photo / 255.0,
        win_size=11,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=2,
        full=True,
    )
    inner = (slice(5, -5), slice(5, -5))
    np.testing.assert_allclose(ssim_map(render, photo)[inner], expected[inner], atol=1e-10)


def test_ssim_pads_with_zeros_and_averages_over_all_pixels():
    render, photo = pictures(16, 20)
    ring = ((5, 5), (5, 5), (0, 0))
    padded = ssim_map(np.pad(render, ring), np.pad(photo, ring))[5:-5, 5:-5]
    np.testing.assert_allclose(ssim_map(render, photo), padded, atol=1e-12)
    assert ssim(render, photo) == pytest.approx(float(padded.mean()))


def test_ssim_against_direct_sums_at_one_pixel():
    render, photo = pictures(11, 11)
    distance = np.arange(11) - 5
    window = np.exp(-(distance[:, None] ** 2 + distance[None] ** 2) / (2 * 1.5**2))
    window /= window.sum()
    x, y = render[..., 1] / 255.0, photo[..., 1] / 255.0
    mx, my = (window * x).sum(), (window * y).sum()
    vx, vy = (window * (x - mx) ** 2).sum(), (window * (y - my) ** 2).sum()
    cov = (window * (x - mx) * (y - my)).sum()
    expected = ((2 * mx * my + 1e-4) * (2 * cov + 9e-4)) / (
        (mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4)
    )
    assert ssim_map(render, photo)[5, 5, 1] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("height", [1, 64, 65, 200])
def test_ssim_is_that_of_the_whole_picture_at_once(height, monkeypatch):
    render, photo = np.random.default_rng(2).integers(0, 256, (2, height, 31, 3)).astype(np.uint8)
    by_bands = ssim_map(render, photo)
    monkeypatch.setattr("clgs.train.quality.scores.BAND", height)
    np.testing.assert_array_equal(by_bands, ssim_map(render, photo))


def test_ssim_is_symmetric_and_falls_with_noise():
    render, photo = pictures()
    assert ssim(render, photo) == pytest.approx(ssim(photo, render), abs=1e-14)
    assert ssim(render, photo) < 0.9
    assert ssim(render, np.clip(render.astype(int) + 1, 0, 255).astype(np.uint8)) > 0.99


def test_to_8bit_rounds_to_nearest_and_clamps():
    values = np.array([-1.0, 0.0, 0.49 / 255, 0.51 / 255, 1.0, 7.0], np.float32)
    image = np.stack([values, values[::-1], np.zeros(6, np.float32)])[:, None, :]
    picture = to_8bit(image)
    assert picture.shape == (1, 6, 3)
    assert picture.dtype == np.uint8
    assert picture[0, :, 0].tolist() == [0, 0, 0, 1, 255, 255]
    assert picture[0, :, 1].tolist() == [255, 255, 1, 0, 0, 0]
    assert picture[0, :, 2].tolist() == [0] * 6


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_to_8bit_returns_every_level(dtype):
    levels = np.arange(256)
    image = np.broadcast_to((levels / 255.0).astype(dtype), (3, 1, 256))
    assert (to_8bit(image)[0] == levels[:, None]).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_to_8bit_refuses_broken_pixels(bad):
    image = np.zeros((3, 4, 4), np.float32)
    image[1, 2, 3] = bad
    with pytest.raises(ClgsError, match="not finite"):
        to_8bit(image)


def test_other_sizes_and_types_are_errors():
    render, photo = pictures()
    for score in (psnr_8bit, ssim):
        with pytest.raises(ValueError, match="photo: shape"):
            score(render, photo[:, :1])
        with pytest.raises(TypeError, match="render: dtype"):
            score(render / 255.0, photo)
    with pytest.raises(ValueError, match="render: shape"):
        psnr_channel_mean(render / 255.0, photo)


def test_counts_each_slot_that_some_view_draws_once(device):
    floats, camera = anchor_scene(2_000, 64)
    scene = QuantizedScene(quantize(floats.anchors, QuantizationScales()), floats.mlps)
    turned = replace(camera, translation=camera.translation + 0.5)
    uploaded, drawn = upload_scene(device, scene.dequantize()), set()
    for one in (camera, turned):
        frame = rasterise(device, uploaded, upload_view(device, one, scene.settings))
        slot = device.download(frame.gaussians.slot)
        visible = device.download(frame.activations.visible)
        drawn |= set((visible[slot // K_OFFSETS] * K_OFFSETS + slot % K_OFFSETS).tolist())
    assert count_drawn(device, scene, [camera, turned, camera]) == len(drawn)
    assert 0 < count_drawn(device, scene, [camera]) < len(drawn) < K_OFFSETS * len(scene.anchors)
    assert count_drawn(device, scene, []) == 0


def scored(lpips: bool = True) -> tuple[dict[str, Any], list[ViewScore]]:
    """Two views with scores that are easy to average."""
    scores = [
        ViewScore("test/r_0.png", 30.0, 30.5, 0.9, 0.1, 0.25 if lpips else None),
        ViewScore("test/r_1.png", 31.0, 31.5, 0.8, 0.1, 0.75 if lpips else None),
    ]
    return summarize(random_scene(np.random.default_rng(0)), scores, 1234), scores


def test_a_summary_says_which_psnr_is_which():
    summary, scores = scored()
    assert (summary["psnr"], summary["psnr_channel_mean"], summary["lpips"]) == (30.5, 31.0, 0.5)
    for name in ("psnr:", "psnr_channel_mean:", "lpips: VGG"):
        assert name in summary["protocol"]
    assert scores[0].record()["lpips"] == 0.25
    summary, scores = scored(lpips=False)
    assert "lpips" not in summary
    assert "lpips" not in summary["protocol"]
    assert "lpips" not in scores[0].record()


def test_inria_files_hold_means_and_views(tmp_path):
    write_inria(tmp_path / "new" / "scores", "ours_30000", *scored())
    results = json.loads((tmp_path / "new/scores/results.json").read_text())
    assert list(results) == ["ours_30000"]
    assert results["ours_30000"].pop("SSIM") == pytest.approx(0.85)
    assert results == {"ours_30000": {"PSNR": 30.5, "LPIPS": 0.5, "PSNR channel mean": 31.0}}
    views = json.loads((tmp_path / "new/scores/per_view.json").read_text())["ours_30000"]
    assert views["PSNR"] == {"r_0.png": 30.0, "r_1.png": 31.0}
    assert views["LPIPS"] == {"r_0.png": 0.25, "r_1.png": 0.75}
    write_inria(tmp_path, "ours", *scored(lpips=False))
    assert set(json.loads((tmp_path / "results.json").read_text())["ours"]) == {
        "SSIM", "PSNR", "PSNR channel mean",
    }  # fmt: skip


def test_survey_rows_are_added_under_one_header(tmp_path):
    table = tmp_path / "mic.csv"
    summary = scored()[0] | {"gaussians": 77}
    append_survey(table, "Baseline", summary)
    table.write_bytes(table.read_bytes().removesuffix(b"\n"))  # as an editor may leave it
    append_survey(table, '-a, "b"', scored(lpips=False)[0] | {"gaussians": 5})
    assert table.read_text().startswith("Submethod,PSNR,SSIM,LPIPS,Size [Bytes],#Gaussians\n")
    with table.open(newline="") as file:
        header, first, second = csv.reader(file)
    assert tuple(header) == HEADER
    assert [float(cell) for cell in first[1:]] == pytest.approx([30.5, 0.85, 0.5, 1234, 77])
    assert (second[0], second[3], second[5]) == ('-a, "b"', "", "5")


@pytest.mark.parametrize("content", [b"a,b\n1,2\n", b"\xff\x00", b"Submethod,PSNR\n"])
def test_other_tables_stay_as_they_are(tmp_path, content):
    table = tmp_path / "other.csv"
    table.write_bytes(content)
    for act in (lambda: check_survey(table), lambda: append_survey(table, "", scored()[0])):
        with pytest.raises(UsageError, match="line 1 is not Submethod,PSNR"):
            act()
    assert table.read_bytes() == content
