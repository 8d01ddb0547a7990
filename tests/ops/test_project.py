"""The projection kernels against the float64 reference, on both specialisations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.constants import NEAR_PLANE
from clgs.ops import project
from clgs.options import PARITY, RenderOptions
from clgs.reference import project as reference
from tests.compare import assert_close, relative_l2
from tests.ops.cases.project import camera_at, d_projected, gaussians, on_device, widen

EPSILON = 2.0**-24


def run_forward(device, values, packed):
    uploaded, camera = on_device(device, values), device.upload(packed)
    return uploaded, camera, project.forward(device, uploaded, camera)


def downloads(device, projected):
    names = ("mean2d", "whitening", "depth", "extent")
    return {name: device.download(getattr(projected, name)) for name in names}


def test_forward_agrees_with_reference(device, rng):
    values = gaussians(rng, 5000)
    packed = camera_at().pack(NEAR_PLANE)
    actual = downloads(device, run_forward(device, values, packed)[2])
    expected = reference.forward(**widen(values), camera=packed)
    drawn = expected.extent[:, 0] > 0
    assert 0.5 < drawn.mean() < 1.0
    assert np.array_equal(actual["extent"][:, 0] > 0, drawn)
    # a dozen roundings of terms no larger than focal * |point| / z + |centre|
    assert_close(actual["mean2d"], expected.mean2d, 12 * EPSILON * 1500, "mean2d")
    assert_close(actual["depth"], expected.depth, 8 * EPSILON * 8, "depth")
    # relative: 40 roundings on the way to the covariance, halved by the square root
    floor = np.abs(expected.whitening).max(axis=0)
    assert_close(actual["whitening"], expected.whitening, 60 * EPSILON * floor, "whitening")
    # near opacity = cut the logarithm vanishes: 1 ulp of opacity/cut moves its root
    limit = 60 * EPSILON * expected.extent + 2e-4 * EPSILON**0.5 * expected.extent.max()
    assert_close(actual["extent"], expected.extent, limit + 1e-6, "extent")


@pytest.mark.parametrize("min_extent", [0.0, 2.5])
def test_small_gaussians_are_left_out_where_asked(device, rng, min_extent):
    values = gaussians(rng, 5000)
    packed = camera_at().pack(NEAR_PLANE)
    options = RenderOptions(replace(PARITY, min_extent=min_extent))
    found = project.forward(device, on_device(device, values), device.upload(packed), options)
    every = downloads(device, run_forward(device, values, packed)[2])
    expected = reference.forward(**widen(values), camera=packed, min_extent=min_extent)
    kept = expected.extent[:, 0] > 0
    # the share that is left: all, or some
    drawn = every["extent"][:, 0] > 0
    assert kept.any()
    assert (min_extent == 0) == (kept.sum() == drawn.sum())
    for name, array in downloads(device, found).items():
        wanted = np.where(kept if array.ndim == 1 else kept[:, None], every[name], 0)
        assert np.array_equal(array, wanted), name


def test_padding_is_culled(device, rng):
    """Gaussians of zeros after the others: no extent, no gradient; no other bit changes."""
    values = gaussians(rng, 100)
    packed = camera_at().pack(NEAR_PLANE)
    plain = downloads(device, run_forward(device, values, packed)[2])
    padded = {n: np.append(v, np.zeros((37, *v.shape[1:]), v.dtype), 0) for n, v in values.items()}
    uploaded, camera, projected = run_forward(device, padded, packed)
    for name, array in downloads(device, projected).items():
        assert np.array_equal(array[:100], plain[name]), name
        assert not array[100:].any(), name
    ones = d_projected(device, np.ones((137, 2), np.float32), np.ones((137, 3), np.float32))
    result = project.backward(device, uploaded, camera, projected, ones)
    for array in (result.d_mean, result.d_scale, result.d_rotation):
        assert device.download(array)[:100].any()
        assert not device.download(array)[100:].any()


@pytest.mark.parametrize(("ratio", "limit"), [(10.0, 1e-5), (1e3, 1e-4), (1e5, 1e-3)])
def test_backward_agrees_with_reference(device, rng, ratio, limit):
    values = gaussians(rng, 4000, ratio)
    packed = camera_at().pack(NEAR_PLANE)
    uploaded, camera, projected = run_forward(device, values, packed)
    expected = reference.forward(**widen(values), camera=packed)
    d_mean2d = rng.normal(size=(4000, 2)).astype(np.float32)
    # as the blend makes them: moments of order one, mapped to r1, l, r2
    r1, _, r2 = np.where(expected.whitening == 0, 1, expected.whitening).T
    moment = rng.normal(size=(4000, 3))
    d_whitening = np.stack([moment[:, 0] / r1, moment[:, 1] * r2 / r1, moment[:, 2] / r2], 1)
    d_whitening = d_whitening.astype(np.float32)
    given = d_projected(device, d_mean2d, d_whitening)
    result = project.backward(device, uploaded, camera, projected, given)
    wide = widen(values)
    wanted = reference.backward(
        (wide["mean"], wide["scale"], wide["rotation"]),
        packed,
        expected,
        d_mean2d.astype(np.float64),
        d_whitening.astype(np.float64),
    )
    for name, array, target in zip(
        ("d_mean", "d_scale", "d_rotation"),
        (result.d_mean, result.d_scale, result.d_rotation),
        wanted,
        strict=True,
    ):
        if name == "d_scale":  # by log scale, as it is trained
            scales = wide["scale"]
            assert relative_l2(device.download(array) * scales, target * scales) <= limit
        else:
            assert relative_l2(device.download(array), target) <= limit, name


def test_whitening_survives_needles(device, rng):
    """N05: exp(-power) inside 3.3 sigma and a 4096-pixel frame, axis ratios up to 1e6."""
    count = 1000
    packed = camera_at(focal=1000.0, width=4096, height=4096).pack(NEAR_PLANE)
    for ratio, limit in ((30.0, 2e-6), (1e3, 5e-5), (1e6, 5e-4)):
        values = gaussians(rng, count)
        values["mean"] *= np.float32(0.3)
        values["scale"][:] = np.float32(1e-3) * np.array([1.0, 1.0, ratio], np.float32)
        actual = downloads(device, run_forward(device, values, packed)[2])
        expected = reference.forward(**widen(values), camera=packed)
        drawn = (expected.extent[:, 0] > 0) & (actual["extent"][:, 0] > 0)
        assert drawn.mean() > 0.9
        r1, slope, r2 = expected.whitening[drawn].T
        y1, y2 = 3.3 * rng.uniform(-0.7, 0.7, (2, int(drawn.sum())))
        dx = y1 / r1
        dy = y2 / r2 + slope * dx
        inside = np.minimum(1, 2048 / np.maximum(np.abs(dx), np.abs(slope * dx)))
        y1, dx, dy = y1 * inside, dx * inside, dy + (inside - 1) * slope * dx
        q1, k, q2 = actual["whitening"][drawn].astype(np.float64).T
        power = 0.5 * ((dx * q1) ** 2 + ((dy - k * dx) * q2) ** 2)
        error = np.abs(np.exp(-power) - np.exp(-0.5 * (y1**2 + y2**2)))
        assert error.max() <= limit, ratio


@pytest.mark.parametrize("slot", ["mean", "scale", "rotation", "opacity"])
@pytest.mark.parametrize("poison", [np.nan, np.inf, -1e38])
def test_poison_stays_in_its_row(device, rng, slot, poison):
    values = gaussians(rng, 65)
    packed = camera_at().pack(NEAR_PLANE)
    clean = downloads(device, run_forward(device, values, packed)[2])
    values[slot][30] = poison
    uploaded, camera, projected = run_forward(device, values, packed)
    dirty = downloads(device, projected)
    others = np.arange(65) != 30
    for name in clean:
        assert np.isfinite(dirty[name]).all(), name
        assert np.array_equal(clean[name][others], dirty[name][others]), name
    ones = d_projected(device, np.ones((65, 2), np.float32), np.ones((65, 3), np.float32))
    result = project.backward(device, uploaded, camera, projected, ones)
    for array in (result.d_mean, result.d_scale, result.d_rotation):
        assert np.isfinite(device.download(array)[others]).all()


def test_no_gaussians(device):
    values = {name: value[:0] for name, value in gaussians(np.random.default_rng(0), 1).items()}
    projected = run_forward(device, values, camera_at().pack(NEAR_PLANE))[2]
    assert projected.mean2d.shape == (0, 2)
