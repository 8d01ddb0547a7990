import numpy as np
import pytest
import raytrace
import scene

pytest.importorskip("embreex")

SUN = np.array([0.6, 0.0, 0.8])
DARK = raytrace.Light(SUN, np.float32([2, 3, 4]), np.zeros(3), np.zeros(3), 0.01)


def look_at(place, target, width):
    return raytrace.View.looking(place, target, width, width, width * 3 // 4)


VIEW = look_at(np.array([3.0, -4.0, 2.0]), np.array([0.1, 0.2, 0.4]), 40)


def flat(place, color=(0.5, 0.5, 0.5)):
    picture = np.full((6, 6, 3), color, np.float32)
    return raytrace.Surface(place, *scene.grid(2, 2), picture)


def floor(color=(0.5, 0.5, 0.5)):
    return flat(scene.plane((-1, 1, 0), (2, 0, 0), (0, -2, 0)), color)


def drop(tracer, x, y):
    """Colour seen straight below (x, y, 0.3)."""
    start = np.float32([[x, y, 0.3]])
    return tracer.shade(start, np.float32([[0, 0, -1]]), SUN.astype(np.float32))[0]


def test_rays_of_a_view_run_through_their_pixels():
    along = VIEW.rays((0.25, 0.5)).astype(np.float64)
    pixels = VIEW.project(VIEW.centre + 7 * along).reshape(30, 40, 2)
    columns, rows = np.meshgrid(np.arange(40) + 0.25, np.arange(30) + 0.5)
    assert np.abs(pixels - np.stack([columns, rows], -1)).max() <= 1e-3
    assert np.abs(np.linalg.norm(along, axis=1) - 1).max() <= 1e-6


def test_up_is_up_and_right_is_right():
    right, upper = VIEW.project(np.array([[0.4, 0.425, 0.4], [0.1, 0.2, 1.0]]))
    assert right[0] > 20
    assert upper[1] < 15


def test_sunlit_surface_follows_lamberts_law():
    tracer = raytrace.RayScene([floor((0.2, 0.4, 0.6))], DARK)
    expected = np.array([0.2, 0.4, 0.6]) * [2, 3, 4] * 0.8
    assert np.abs(drop(tracer, 0.3, -0.4) - expected).max() <= 1e-5


def test_roof_throws_its_shadow_along_the_sun():
    roof = flat(scene.plane((-0.2, 0.2, 1), (0.4, 0, 0), (0, -0.4, 0)))
    tracer = raytrace.RayScene([floor(), roof], DARK)
    shadow = -0.75  # one metre up at slope 0.6 / 0.8
    assert np.all(drop(tracer, shadow, 0) < 0.5 * drop(tracer, 0.75, 0))
    assert np.all(drop(tracer, shadow, 0.6) > 0.5 * drop(tracer, 0.75, 0))


def test_picture_is_upright_and_not_mirrored():
    picture = np.zeros((8, 8, 3), np.float32)
    picture[:4, :4] = 1  # upper left
    wall = scene.plane((-1, 0, 2), (2, 0, 0), (0, 0, -2))
    tracer = raytrace.RayScene([raytrace.Surface(wall, *scene.grid(1, 1), picture)], DARK)
    view = look_at(np.array([0.0, -3.0, 1.0]), np.array([0.0, 0.0, 1.0]), 40)
    hits = tracer.trace(np.float32([view.centre] * 1200), view.rays((0.5, 0.5)))
    left, top = (hits.uv[:, axis].reshape(30, 40) for axis in (0, 1))
    assert np.all(np.diff(left[15, 10:30]) > 0)
    assert np.all(np.diff(top[5:25, 20]) > 0)


def test_ball_is_round():
    ball = scene.ball("retina", (0.5, 0.25, 1.0), 0.4)
    tracer = raytrace.RayScene([ball], DARK)
    view = look_at(np.array([3.0, -3.0, 2.0]), np.array([0.5, 0.25, 1.0]), 40)
    along = view.rays((0.5, 0.5))
    hits = tracer.trace(np.float32([view.centre] * len(along)), along)
    hit = hits.face >= 0
    outward = (view.centre + hits.distance[:, None] * along)[hit] - [0.5, 0.25, 1.0]
    assert hit.sum() > 20
    assert np.abs(np.linalg.norm(outward, axis=1) - 0.4).max() <= 2e-3
    assert np.abs(outward / 0.4 - hits.normal[hit]).max() <= 0.02


def test_develop_is_gamma_and_clips():
    color = np.float32([[0, 1, 4], [0.5, -1, 1]])
    assert raytrace.develop(color).tolist() == [[0, 255, 255], [186, 0, 255]]


def test_hemisphere_is_cosine_weighted():
    normal = np.array([[0.0, 0.6, 0.8], [0.0, 0.0, 1.0]])
    directions = raytrace.hemisphere(normal, 400).reshape(2, 400, 3)
    cosine = np.einsum("pkc,pc->pk", directions, normal)
    assert cosine.min() > 0
    assert np.abs(cosine.mean(1) - 2 / 3).max() <= 0.01
    assert np.abs(np.linalg.norm(directions, axis=2) - 1).max() <= 1e-9
