"""Distortion models against pycolmap, and undistorted images against the geometry."""

from dataclasses import replace

import numpy as np
import pytest

from clgs.data.images import Pixels
from clgs.data.lens import Lens, undistort_lens, undistort_pixels

PHONE = Lens(400, 300, 310.0, 305.0, 207.3, 145.8, (0.0578, -0.0805), (), (-0.00098, 0.00156))
STRONG = replace(PHONE, radial=(-0.2, 0.05, 0.01))
PINCUSHION = replace(PHONE, radial=(0.15, 0.02))
RATIONAL = replace(PHONE, radial=(0.3, 0.1, 0.02), divisor=(0.25, 0.05, 0.01))
FISHEYE = replace(PHONE, radial=(0.03, -0.01, 0.002, 0.0), tangential=(0.0, 0.0), fisheye=True)
LENSES = {"OPENCV": PHONE, "FULL_OPENCV": RATIONAL, "OPENCV_FISHEYE": FISHEYE}
SKEWED = replace(PHONE, skew=-0.002)
TANGENTIAL_FISHEYE = replace(FISHEYE, tangential=(0.0011, -0.0007), skew=0.001)
ALL = [PHONE, STRONG, PINCUSHION, RATIONAL, FISHEYE, SKEWED, TANGENTIAL_FISHEYE]


def ideal_points(lens: Lens) -> np.ndarray:
    """Points (N, 2) of the ideal plane over the undistorted image."""
    pinhole, _ = undistort_lens(lens)
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, 1, (500, 2)) * (pinhole.width, pinhole.height)
    return (pixels - (pinhole.cx, pinhole.cy)) / (pinhole.fx, pinhole.fy)


@pytest.mark.parametrize("model", LENSES)
def test_models_equal_colmap(model):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    lens = LENSES[model]
    params = [lens.fx, lens.fy, lens.cx, lens.cy]
    if lens.fisheye:
        params += lens.radial
    else:
        params += [*lens.radial[:2], *lens.tangential, *lens.radial[2:], *lens.divisor]
    camera = pycolmap.Camera(model=model, width=400, height=300, params=params)
    points = ideal_points(lens)
    expected = camera.img_from_cam(np.column_stack([points, np.ones(len(points))]))
    found = lens.distort(points) * (lens.fx, lens.fy) + (lens.cx, lens.cy)
    assert np.abs(found - expected).max() <= 1e-9


@pytest.mark.parametrize("lens", ALL)
def test_undistort_inverts_distort(lens):
    points = ideal_points(lens)
    assert np.abs(lens.undistort(lens.distort(points)) - points).max() <= 1e-7


@pytest.mark.parametrize("lens", ALL)
def test_every_undistorted_pixel_has_a_source(lens):
    pinhole, _ = undistort_lens(lens)
    x, y = np.meshgrid([0.5, pinhole.width - 0.5], np.arange(pinhole.height) + 0.5)
    pixels = np.column_stack([x.ravel(), y.ravel()])
    ideal = (pixels - (pinhole.cx, pinhole.cy)) / (pinhole.fx, pinhole.fy)
    source = lens.distort(ideal) * (lens.fx, lens.fy) + (lens.cx, lens.cy)
    assert source.min() >= 0.0
    assert (source <= (lens.width, lens.height)).all()
    assert pinhole.width >= 0.7 * lens.width


@pytest.mark.parametrize("lens", ALL)
def test_undistorted_image_shows_points_where_the_pinhole_projects_them(lens):
    """The input holds its own pixel coordinates as colour; the output then tells its sources."""
    pinhole, _ = undistort_lens(lens)
    columns, rows = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
    worst = 0.0
    for axis, values in enumerate((columns, rows)):
        # 20 pixels over the whole range of a byte: a level is less than 0.08 px before rounding.
        phase = values / 40.0 % 1.0
        color = np.rint(np.abs(phase * 2 - 1) * 255).astype(np.uint8)
        image = undistort_pixels(Pixels(np.dstack([color] * 3), None), lens)
        assert image.size == (pinhole.width, pinhole.height)
        x, y = np.meshgrid(np.arange(pinhole.width) + 0.5, np.arange(pinhole.height) + 0.5)
        ideal = np.column_stack([(x.ravel() - pinhole.cx), (y.ravel() - pinhole.cy)])
        ideal /= (pinhole.fx, pinhole.fy)
        source = lens.distort(ideal) * (lens.fx, lens.fy) + (lens.cx, lens.cy)
        phase = source[:, axis] / 40.0 % 1.0
        smooth = (np.abs(phase * 2 - 1) > 0.1) & (np.abs(phase * 2 - 1) < 0.9)
        expected = np.abs(phase * 2 - 1)[smooth] * 255
        error = np.abs(image.color[..., 0].ravel()[smooth] - expected) / 255 * 20
        worst = max(worst, float(np.percentile(error, 95)))
        assert abs(float((image.color[..., 0].ravel()[smooth] - expected).mean())) <= 0.3
    assert worst <= 0.08


def test_plain_lens_is_left_alone():
    lens = Lens(20, 10, 5.0, 5.0, 10.0, 5.0, (0.0, 0.0))
    pixels = Pixels(np.zeros((10, 20, 3), np.uint8), None)
    assert undistort_pixels(pixels, lens) is pixels
    assert undistort_lens(lens) == (lens, (0, 0))


def test_alpha_is_undistorted_too():
    alpha = np.zeros((300, 400), np.uint8)
    alpha[:, :200] = 255
    image = undistort_pixels(Pixels(np.zeros((300, 400, 3), np.uint8), alpha), PHONE)
    pinhole, _ = undistort_lens(PHONE)
    assert image.alpha.shape == (pinhole.height, pinhole.width)
    assert image.alpha[:, 0].min() == 255
    assert image.alpha[:, -1].max() == 0


@pytest.mark.parametrize("view", [60.0, 90.0, 120.0])
def test_the_picture_of_a_fisheye_shows_the_chosen_view(view):
    """An equidistant lens of 180 degrees: half the height is a quarter of a turn."""
    lens = Lens(600, 600, 600 / np.pi, 600 / np.pi, 300.0, 300.0, fisheye=True)
    whole, _ = undistort_lens(lens)
    pinhole, corner = undistort_lens(replace(lens, view=view))
    assert whole.width > pinhole.width
    half = lens.fx * np.tan(np.radians(view / 2))
    assert abs(pinhole.width / 2 - half) < 1
    assert abs(pinhole.height / 2 - half) < 1
    assert (pinhole.fx, pinhole.cx + corner[0]) == (lens.fx, lens.cx)
    rays = np.array([[np.tan(np.radians(view / 2)), 0.0]])
    assert np.allclose(lens.distort(rays), [[np.radians(view / 2), 0.0]])
