"""Opacities of Gaussians that the screen's blur widens, against the float64 reference."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.constants import BLUR, NEAR_PLANE
from clgs.ops.general import antialias
from clgs.reference.general import antialias as reference
from tests.compare import assert_close
from tests.ops.cases.project import camera_at, gaussians, on_device, widen


def run_forward(device, values, packed):
    found = antialias.forward(device, on_device(device, values), device.upload(packed))
    return device.download(found.opacity)


@pytest.mark.parametrize("times", [1e-3, 0.05, 1.0, 30.0])
def test_opacities_agree_with_reference(device, rng, times):
    values, packed = gaussians(rng, 3000), camera_at().pack(NEAR_PLANE)
    values["scale"] *= np.float32(times)
    wanted = reference.forward(**widen(values), camera=packed)
    # relative: the roots of two sums of products with some dozens of roundings
    assert_close(run_forward(device, values, packed), wanted, 60 * 2.0**-24 * wanted, "opacity")


def test_a_ball_of_a_pixel_keeps_its_share(device):
    """Seen along the axis, its covariance is (focal * scale / depth)^2 on both diagonals."""
    camera = camera_at(400.0)
    values = {
        "mean": (camera.centre + 4.0 * camera.rotation[2])[None],
        "scale": np.full((1, 3), 4.0 / 400.0),
        "rotation": np.array([[1.0, 0, 0, 0]]),
        "opacity": np.array([0.5]),
    }
    values = {name: value.astype(np.float32) for name, value in values.items()}
    x, y = 1.0, 1.1**2  # the focal lengths of the camera differ
    share = np.sqrt(x * y / ((x + BLUR) * (y + BLUR)))
    assert run_forward(device, values, camera.pack(NEAR_PLANE))[0] == pytest.approx(0.5 * share)


def test_no_gaussians_and_wrong_arrays(device, rng):
    packed = camera_at().pack(NEAR_PLANE)
    few = {name: value[:0] for name, value in gaussians(rng, 2).items()}
    assert run_forward(device, few, packed).shape == (0,)
    with pytest.raises(ValueError, match="camera"):
        run_forward(device, gaussians(rng, 2), packed[:25])
