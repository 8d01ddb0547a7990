"""The reference of ordinary Gaussians against central differences; their functions' properties."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.constants import NEAR_PLANE
from clgs.reference.general import splats as reference
from clgs.reference.neural import Gaussians
from tests.compare import assert_close, central_difference
from tests.ops.cases.project import camera_at
from tests.ops.cases.splats import gradients, stored, widen

PACKED = camera_at().pack(NEAR_PLANE).astype(np.float64)
NAMES = ("mean", "log_scale", "rotation", "opacity", "sh")


@pytest.mark.parametrize("which", NAMES)
def test_gradient(rng, which):
    values = widen(stored(rng, 6))
    wide = {n: array.astype(np.float64) for n, array in gradients(rng, 6).items()}
    d_seen = Gaussians(**wide)

    def objective(x):
        changed = {name: getattr(values, name) for name in NAMES} | {which: x}
        seen = reference.forward(reference.Stored(**changed), PACKED)
        return float(sum(np.sum(wide[name] * getattr(seen, name)) for name in wide))

    analytic = getattr(reference.backward(values, PACKED, d_seen), which)
    numeric = central_difference(objective, getattr(values, which)).reshape(analytic.shape)
    assert_close(analytic, numeric, 1e-6 * np.abs(numeric).max(), which)


def test_the_functions_are_orthonormal_on_the_sphere():
    """Gauss-Legendre by z and an even turn integrate products of degree 6 exactly."""
    z, weight = np.polynomial.legendre.leggauss(8)
    turn = 2 * np.pi * np.arange(16) / 16
    flat = np.sqrt(1 - z**2)
    grid = np.stack(
        [flat[:, None] * np.cos(turn), flat[:, None] * np.sin(turn), z[:, None] + 0 * turn], -1
    ).reshape(-1, 3)
    basis = reference.basis(grid, 16)
    area = np.repeat(weight * 2 * np.pi / 16, 16)
    assert_close(basis.T @ (area[:, None] * basis), np.eye(16), 1e-12, "products")
