"""The reference of projection for any camera against central differences, by camera model."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.ops.general.views import pack_camera
from clgs.reference.general import views as reference
from tests.compare import assert_close, central_difference

COUNT = 12
INTRINSICS = np.array([[40.0, 0, 50], [0, 44, 48], [0, 0, 1]])


@pytest.mark.parametrize("model", ["pinhole", "ortho", "fisheye"])
@pytest.mark.parametrize("compensated", [False, True])
def test_gradients(rng, model, compensated):
    mean = rng.uniform(-1, 1, (COUNT, 3))
    mean[:4, 2] = rng.uniform(-2.4, -2.0, 4)  # up to 70 degrees from the axis
    camera = pack_camera(np.eye(4), INTRINSICS, (100, 96), 0.01).astype(np.float64)
    camera[:9] += rng.normal(0, 0.05, 9)
    camera[9:12] = 0.1, -0.2, 2.8
    on_axis = np.array([[0, 0, 2], [0.01, -0.02, 2], [0, 0.05, 2]]) - camera[9:12]
    mean[4:7] = np.linalg.solve(camera[:9].reshape(3, 3), on_axis.T).T
    shape = reference.covariances(rng.uniform(0.1, 0.3, (COUNT, 3)), rng.normal(size=(COUNT, 4)))
    opacity, lens = rng.uniform(0.3, 0.9, COUNT), reference.CameraModel(model, compensated)
    d = [rng.normal(size=size) for size in ((COUNT, 2), (COUNT, 3), COUNT, COUNT)]
    seen = reference.forward(mean, shape, opacity, camera, lens)[0]
    assert (seen.extent[:, 0] > 0).sum() >= 9
    assert (seen.extent[4:7, 0] > 0).all()
    made = reference.backward(mean, shape, opacity, camera, lens, *d)

    def objective(**changed):
        given = {"mean": mean, "covariance": shape, "opacity": opacity, "camera": camera} | changed
        found, left = reference.forward(**given, lens=lens)
        values = found.mean2d, found.whitening, found.depth, left
        return float(sum(np.sum(one * value) for one, value in zip(d, values, strict=True)))

    def by_matrix(rows):
        matrix = np.concatenate([rows[:, :3].ravel(), rows[:, 3], camera[12:]])
        return objective(camera=matrix)

    def by_symmetric(covariance):
        return objective(covariance=(covariance + covariance.swapaxes(1, 2)) / 2)

    rows = np.concatenate([camera[:9].reshape(3, 3), camera[9:12, None]], axis=1)
    cases = [
        (lambda x: objective(mean=x), mean, made.d_mean),
        (by_symmetric, shape, made.d_covariance),
        (lambda x: objective(opacity=x), opacity, made.d_opacity),
        (by_matrix, rows, made.d_camera),
    ]
    for function, at, analytic in cases:
        numeric = central_difference(function, at).reshape(analytic.shape)
        assert_close(analytic, numeric, 1e-6 * np.abs(numeric).max(), model)
