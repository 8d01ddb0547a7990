"""The loss kernels against the float64 reference, on both specialisations."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.ops import loss
from clgs.reference import loss as reference
from tests.compare import assert_close, relative_l2

EPSILON = 2.0**-24
SIZES = [(1, 1), (1, 17), (17, 1), (15, 16), (33, 47), (257, 33)]


def photo(rng, height, width):
    """A smooth picture with noise, as 8-bit levels."""
    y, x = np.mgrid[:height, :width]
    waves = 127 + 70 * np.sin(x / 9 + np.arange(3)[:, None, None]) + 50 * np.cos(y / 7)
    return np.clip(waves + rng.normal(0, 8, waves.shape), 0, 255).astype(np.uint8)


def levels_of(pixels):
    return (pixels / 255.0).astype(np.float32)


def run(device, image, target, weights=None):
    arrays = device.upload(image.astype(np.float32)), device.upload(target)
    result = loss.forward(device, *arrays, weights)
    return result, device.download(loss.backward(device, *arrays, result))


@pytest.mark.parametrize("size", SIZES)
def test_agrees_with_reference(device, rng, size):
    target = photo(rng, *size)
    image = (levels_of(target) + rng.normal(0, 0.05, target.shape)).astype(np.float32)
    weights = loss.Weights(0.3, 0.7)
    result, d_image = run(device, image, target, weights)
    value, expected = result.value(device), reference.forward(image.astype(float), target, 0.3, 0.7)
    # means of float32 terms of at most 1, summed over a tile in 32-bit, then in 64-bit
    assert_close(value.l1, expected.l1, 4 * EPSILON * expected.l1, "l1")
    assert_close(value.ssim, expected.ssim, 4 * EPSILON, "ssim")
    assert_close(value.value, expected.value, 4 * EPSILON, "value")
    d_expected = reference.backward(image.astype(float), target, 0.3, 0.7)
    assert relative_l2(d_image, d_expected) <= 2e-6
    # two blurs of 22 roundings each of terms up to the largest gradient, and the L1 term
    assert_close(d_image, d_expected, 64 * EPSILON * np.abs(d_expected).max(), "d_image")


def noise(rng, level, amplitude):
    values = level + rng.integers(-amplitude, amplitude + 1, (3, 96, 80))
    return np.clip(values, 0, 255).astype(np.uint8)


def hard_pairs(rng):
    """Pictures whose variances cancel when taken about zero: (image float32, target)."""
    checker = np.indices((96, 80)).sum(axis=0) // 24 % 2 * 255
    ramp = np.broadcast_to(np.linspace(0, 255, 80), (3, 96, 80))
    for level in (0, 128, 255):
        flat = noise(rng, level, 0)
        yield f"flat {level}", levels_of(flat), flat
        yield f"flat {level}, 0.9", np.full_like(levels_of(flat), 0.9), flat
        yield f"one level around {level}", levels_of(noise(rng, level, 1)), noise(rng, level, 1)
        quarter = levels_of(flat) + rng.normal(0, 0.25 / 255, flat.shape)
        yield f"quarter level around {level}", quarter, noise(rng, level, 1)
    yield "checker", levels_of(noise(rng, checker, 1)), noise(rng, checker, 1)
    yield "checker inverted", levels_of(255 - noise(rng, checker, 0)), noise(rng, checker, 0)
    yield "ramp", ramp / 255, ramp.astype(np.uint8)


@pytest.mark.slow
@pytest.mark.family("N30")
def test_variances_do_not_cancel(device, rng):
    for name, image, target in hard_pairs(rng):
        image = image.astype(np.float32)
        result, d_image = run(device, image, target)
        wide, levels = image.astype(np.float64), reference.to_levels(target)
        ssim = reference.ssim_map(wide, levels)
        assert_close(result.value(device).ssim, ssim.mean(), 1e-6, f"{name}: mean")
        v, w = (device.download(plane).astype(np.float64) for plane in result.maps[1:])
        # w/v is the share of contrast and structure that is lost: where cancellation shows
        contrast = contrast_structure(wide, levels)
        assert_close(1 - w / v, contrast, 2e-4, f"{name}: map")
        d_expected = reference.backward(wide, target)
        if np.linalg.norm(d_expected) > 1e-12:
            # tiles with black and white hold levels of 1/2, noise of 1/255 and a window's sums
            assert relative_l2(d_image, d_expected) <= 2e-5, name
        else:
            assert_close(d_image, d_expected, 1e-12, f"{name}: d_image")


def contrast_structure(x, y):
    """(2 cov + C2) / (var_x + var_y + C2)."""
    mu_x, mu_y = reference.blur(x), reference.blur(y)
    covariance = reference.blur(x * y) - mu_x * mu_y
    variances = reference.blur(x * x) - mu_x**2 + reference.blur(y * y) - mu_y**2
    return (2 * covariance + reference.SSIM_C2) / (variances + reference.SSIM_C2)


def test_equal_pictures_lose_nothing(device, rng):
    target = photo(rng, 50, 70)
    result, d_image = run(device, levels_of(target), target)
    value = result.value(device)
    assert (value.l1, value.ssim, value.value) == (0.0, 1.0, 0.0)
    assert np.array_equal(d_image, np.zeros_like(d_image))


def test_ssim_agrees_with_scikit_image(device, rng):
    structural_similarity = pytest.importorskip("skimage.metrics").structural_similarity
    target = photo(rng, 80, 60)
    image = (levels_of(target) + rng.normal(0, 0.05, target.shape)).astype(np.float32)
    _, expected = structural_similarity(
        image.astype(float),
        reference.to_levels(target),
        data_range=1.0,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        channel_axis=0,
        full=True,
    )
    actual = reference.ssim_map(image.astype(float), reference.to_levels(target))
    inner = (slice(None), slice(5, -5), slice(5, -5))
    assert_close(actual[inner], expected[inner], 1e-9, "inner crop")
    result, _ = run(device, image, target)
    assert_close(result.value(device).ssim, actual.mean(), 4 * EPSILON, "ssim")


def flat_pairs(rng):
    """Pictures and photos that are flat in most tiles."""
    y, x = np.mgrid[:150, :170]
    disc = (x - 85.0) ** 2 + (y - 75.0) ** 2 < 900
    for level, shown in ((0, 0.0), (255, 1.0), (0, 1.0), (128, 128 / 255), (0, 0.1), (0, -0.0)):
        target = np.where(disc, photo(rng, 150, 170), level).astype(np.uint8)
        image = np.full((3, 150, 170), shown, np.float32)
        image[:, 40:60, 30:90] = rng.random((3, 20, 60))
        yield image, target
    lone = np.zeros((3, 150, 170), np.float32)
    lone[:, 75, 85] = 1e-30
    yield lone, np.zeros(lone.shape, np.uint8)
    lone[1, 75, 85] = np.nan
    yield lone.copy(), np.zeros(lone.shape, np.uint8)


@pytest.mark.slow
def test_flat_tiles_give_the_same_bits_as_sums_of_zeros(device, rng, monkeypatch):
    defines = loss._defines
    for image, target in flat_pairs(rng):
        result, d_image = run(device, image, target)
        with monkeypatch.context() as patch:
            patch.setattr(loss, "_defines", lambda device: {**defines(device), "SKIP_FLAT": 0})
            plain, d_plain = run(device, image, target)
        assert device.download(result.shift).tobytes() == device.download(plain.shift).tobytes()
        for mine, other in zip((*result.maps, result.sums), (*plain.maps, plain.sums), strict=True):
            assert np.array_equal(device.download(mine), device.download(other), equal_nan=True)
        assert np.array_equal(d_image, d_plain, equal_nan=True)


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
def test_poison_reaches_the_value(device, rng, poison):
    target = photo(rng, 40, 50)
    image = levels_of(target).copy()
    image[1, 20, 33] = poison
    result, d_image = run(device, image, target)
    assert not np.isfinite(result.value(device).value)
    assert np.isfinite(d_image[[0, 2]]).all(), "the other channels are untouched"


def test_volume_agrees_and_adds(device, rng):
    for count in (0, 1, 255, 256, 257, 5000):
        scale = np.exp(rng.normal(-2, 1, (count, 3))).astype(np.float32)
        start = rng.normal(size=(count, 3)).astype(np.float32) * 1e-4
        d_scale = device.upload(start)
        loss.volume(device, device.upload(scale), 0.01, d_scale)
        gradient = reference.volume(scale.astype(np.float64), 0.01)[1]
        limit = 4 * EPSILON * (np.abs(gradient) + np.abs(start))
        assert_close(device.download(d_scale), start + gradient, limit, "d_scale")


def test_volume_takes_the_number_from_the_device(device, rng):
    scale = np.exp(rng.normal(-2, 1, (700, 3))).astype(np.float32)
    start = rng.normal(size=(700, 3)).astype(np.float32) * 1e-4
    plain = device.upload(start)
    loss.volume(device, device.upload(scale), 0.01, plain)
    for spare in (0, 1, 500):
        wide = [np.append(one, np.zeros((spare, 3), np.float32), axis=0) for one in (scale, start)]
        d_scale, total = device.upload(wide[1]), device.upload(np.array([700], np.int64))
        loss.volume(device, device.upload(wide[0]), 0.01, d_scale, total)
        assert np.array_equal(device.download(d_scale)[:700], device.download(plain))
        assert not device.download(d_scale)[700:].any()


def test_wrong_arrays_are_refused(device):
    image = device.zeros((3, 4, 5))
    with pytest.raises(TypeError, match="target"):
        loss.forward(device, image, image)
    with pytest.raises(ValueError, match="target"):
        loss.forward(device, image, device.zeros((3, 5, 4), np.uint8))
    with pytest.raises(ValueError, match="d_scale"):
        loss.volume(device, device.zeros((4, 3)), 1.0, device.zeros((5, 3)))


@pytest.mark.parametrize("size", SIZES)
def test_both_forms_make_the_same_bits(open_device, rng, size):
    target = photo(rng, *size)
    image = (levels_of(target) + rng.normal(0, 0.05, target.shape)).astype(np.float32)
    devices = [open_device(form) for form in ("cpu", "gpu")]
    (mine, d_mine), (other, d_other) = (run(device, image, target) for device in devices)
    assert mine.value(devices[0]) == other.value(devices[1])
    assert np.array_equal(d_mine, d_other)
