"""Colors from spherical harmonics against the float64 reference."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.ops.general import harmonics
from clgs.reference.general import harmonics as reference
from tests.compare import relative_l2


def packed(centre):
    camera = np.zeros(26, np.float32)
    camera[23:] = centre
    return camera


@pytest.mark.slow
@pytest.mark.parametrize(
    ("degree", "rows", "bare"),
    [
        *((0, 1, False), (0, 4, True), (1, 4, False), (2, 16, True), (3, 16, False)),
        *((3, 16, True), (4, 25, False)),
    ],
)
def test_agrees_with_reference(device, rng, degree, rows, bare):
    count, centre = 701, np.array([0.3, -0.2, 0.1], np.float32)
    mean = rng.normal(size=(count, 3)).astype(np.float32)
    sh = rng.normal(0, 1, (count, rows, 3)).astype(np.float32)
    d_color = rng.normal(size=(count, 3)).astype(np.float32)
    given = device.upload(mean), device.upload(sh), device.upload(packed(centre)), degree
    color = harmonics.forward(device, *given, bare)
    wide = mean.astype(float), sh.astype(float), centre.astype(float), degree
    wanted = reference.forward(*wide, bare)
    assert (wanted == 0).any() != bare
    assert relative_l2(device.download(color), wanted) < 1e-6
    made = harmonics.backward(device, *given, color, device.upload(d_color), bare)
    expected = reference.backward(*wide, d_color.astype(float), bare)
    assert not device.download(made[0])[:, (degree + 1) ** 2 :].any()
    for array, target in zip(made, expected, strict=True):
        if target.any():
            assert relative_l2(device.download(array), target) < 1e-5
        else:
            assert not device.download(array).any()


def test_a_mean_in_the_centre_and_a_wrong_degree(device):
    zero, sh = device.zeros((1, 3)), device.upload(np.ones((1, 4, 3), np.float32))
    camera = device.upload(packed(0))
    color = harmonics.forward(device, zero, sh, camera, 1)
    assert np.allclose(device.download(color), 0.5 + 0.28209479)
    d_sh, d_mean = harmonics.backward(device, zero, sh, camera, 1, color, color)
    assert np.isfinite(device.download(d_sh)).all()
    assert not device.download(d_mean).any()
    with pytest.raises(ValueError, match="degree: 2 needs 9 harmonics"):
        harmonics.forward(device, zero, sh, camera, 2)
