"""Projection on screens of other sizes than the photos', against the float64 reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.constants import BLUR, NEAR_PLANE, PIXEL_VARIANCE
from clgs.ops import project
from clgs.reference import project as reference
from tests.compare import assert_close, relative_l2
from tests.ops.cases.project import camera_at, d_projected, gaussians, on_device, widen

EPSILON = 2.0**-24
POINT = (0.2, -0.1, 0.3)
SCREENS = {
    "antialiased": project.ANTIALIASED,
    "enlarged": project.Screen(*POINT, 3.8, 4.2, 4.0),
    "reduced": project.Screen(*POINT, 3.8, 4.2, 0.25),
    "nearer": project.Screen(*POINT, 9.0, 9.5, 1.0),
    "farther": project.Screen(*POINT, 0.0, 0.1, 1.0),
    "among": project.Screen(*POINT, 0.0, 9.0, 1.0),
    "mixed": project.Screen(*POINT, 5.4, 5.6, 0.9),
}


def shape_of(values):
    wide = widen(values)
    return tuple(wide[name] for name in ("mean", "scale", "rotation"))


@pytest.mark.parametrize("times", [0.05, 1.0])
@pytest.mark.parametrize("name", SCREENS)
def test_agrees_with_reference(device, rng, name, times):
    screen, values, packed = SCREENS[name], gaussians(rng, 3000), camera_at().pack(NEAR_PLANE)
    values["scale"] *= np.float32(times)
    camera = device.upload(packed)
    found = project.forward(device, on_device(device, values), camera, screen=screen)
    shape, opacity = shape_of(values), widen(values)["opacity"]
    shown = reference.shown_opacity(shape, opacity, packed, screen)
    # relative: the roots of two sums of products with some dozens of roundings
    assert_close(device.download(found.opacity), shown, 80 * EPSILON * shown, "opacity")
    expected = reference.forward(*shape, opacity, packed, screen=screen)
    drawn = expected.extent[:, 0] > 0
    extent = device.download(found.extent)
    assert np.mean((extent[:, 0] > 0) == drawn) > 0.999
    both = drawn & (extent[:, 0] > 0)
    assert both.sum() > 300
    whitening = device.download(found.whitening)[both]
    floor = np.abs(expected.whitening[both]).max(axis=0)
    assert_close(whitening, expected.whitening[both], 60 * EPSILON * floor, "whitening")
    # near opacity = cut the logarithm vanishes: 1 ulp of opacity/cut moves its root
    limit = 80 * EPSILON * expected.extent + 3e-4 * EPSILON**0.5 * expected.extent.max()
    assert_close(extent[both], expected.extent[both], limit[both] + 1e-6, "extent")


@pytest.mark.parametrize("name", ["nearer", "farther", "mixed"])
def test_distance_counts_beyond_those_of_the_photos(rng, name):
    packed, values = camera_at().pack(NEAR_PLANE), gaussians(rng, 3000)
    blur, learned = reference.blurs(reference.unpack(packed), widen(values)["mean"], SCREENS[name])
    size = np.sqrt(learned / BLUR)
    assert {"nearer": size.min() > 1, "farther": size.max() < 1}.get(name, True)
    if name == "mixed":
        assert size.min() == pytest.approx(0.9)
        assert size.max() > 1.05
    pixel = np.where(size < 1, (1 - size**2) * PIXEL_VARIANCE, 0)
    assert blur == pytest.approx(BLUR * size**2 + pixel)


def test_among_the_photos_no_bit_changes(device, rng):
    """Cameras as near as some photo's, with a focal length as long: the picture of training."""
    values, packed = gaussians(rng, 3000), device.upload(camera_at().pack(NEAR_PLANE))
    uploaded = on_device(device, values)
    usual = project.forward(device, uploaded, packed)
    centre = camera_at().centre
    away = float(np.linalg.norm(centre - np.array(POINT)))
    seen = project.Screen(*POINT, 0.999 * away, 1.001 * away, 1.0)
    found = project.forward(device, uploaded, packed, screen=seen)
    for name, array in vars(found).items():
        wanted = device.download(getattr(usual, name))
        assert device.download(array).tobytes() == wanted.tobytes(), name
    assert device.download(usual.opacity).tobytes() == values["opacity"].tobytes()


@pytest.mark.parametrize(("screen", "blur", "learned"), [
    (project.ANTIALIASED, BLUR, 0.0),
    (project.Screen(0, 0, 0, 0, 9, 2.0), 4 * BLUR, 4 * BLUR),
    (project.Screen(0, 0, 0, 0, 9, 0.5), BLUR / 4 + 0.75 / 12, BLUR / 4),
])  # fmt: skip
def test_a_ball_of_a_pixel_keeps_its_share(device, screen, blur, learned):
    """Seen along the axis, its covariance is (focal * scale / depth)^2 on both diagonals."""
    camera = camera_at(400.0)
    values = {
        "mean": (camera.centre + 4.0 * camera.rotation[2])[None],
        "scale": np.full((1, 3), 4.0 / 400.0),
        "rotation": np.array([[1.0, 0, 0, 0]]),
        "opacity": np.array([0.5]),
    }
    values = {name: value.astype(np.float32) for name, value in values.items()}
    packed = device.upload(camera.pack(NEAR_PLANE))
    found = project.forward(device, on_device(device, values), packed, screen=screen)
    x, y = 1.0, 1.1**2  # the focal lengths of the camera differ
    share = np.sqrt((x + learned) * (y + learned) / ((x + blur) * (y + blur)))
    assert device.download(found.opacity)[0] == pytest.approx(0.5 * share)
    assert device.download(found.whitening)[0, 0] == pytest.approx((x + blur) ** -0.5)


@pytest.mark.parametrize("times", [0.05, 1.0])
def test_gradients_of_antialiased_ones_agree_with_reference(device, rng, times):
    values, packed = gaussians(rng, 4000), camera_at().pack(NEAR_PLANE)
    values["scale"] *= np.float32(times)
    values["opacity"] = np.maximum(values["opacity"], np.float32(0.3))
    camera, uploaded = device.upload(packed), on_device(device, values)
    projected = project.forward(device, uploaded, camera, screen=project.ANTIALIASED)
    shape, opacity = shape_of(values), widen(values)["opacity"]
    expected = reference.forward(*shape, opacity, packed, screen=project.ANTIALIASED)
    given = d_projected(device, *(np.zeros((4000, n), np.float32) for n in (2, 3)))
    d_shown = rng.normal(size=4000).astype(np.float32)
    given = replace(given, d_opacity=device.upload(d_shown))
    found = project.backward(device, uploaded, camera, projected, given, antialiased=True)
    shown = reference.shown_opacity(shape, opacity, packed, project.ANTIALIASED)
    zero = given.d_mean2d.shape, given.d_whitening.shape
    wanted = reference.backward(
        shape, packed, expected, *map(np.zeros, zero), d_share=d_shown * shown
    )
    for name, target in zip(("d_mean", "d_scale", "d_rotation"), wanted, strict=True):
        assert relative_l2(device.download(getattr(found, name)), target) <= 1e-4, name
    drawn = device.download(projected.extent)[:, 0] > 0
    share = np.where(drawn, shown / opacity, 0)
    assert relative_l2(device.download(found.d_opacity), d_shown * share) <= 1e-5


def test_no_gaussians_and_no_numbers(device, rng):
    packed = device.upload(camera_at().pack(NEAR_PLANE))
    few = {name: value[:0] for name, value in gaussians(rng, 2).items()}
    screen = SCREENS["mixed"]
    assert len(project.forward(device, on_device(device, few), packed, screen=screen).opacity) == 0
    values = gaussians(rng, 40)
    values["mean"][7] = np.nan
    values["mean"][9] = camera_at().centre
    found = project.forward(device, on_device(device, values), packed, screen=screen)
    assert not device.download(found.extent)[[7, 9]].any()
