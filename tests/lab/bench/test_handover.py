"""What is handed to gsplat gives our picture by gsplat's own rules, and lies where it says."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from clgs.errors import UsageError
from clgs.lab.bench.gsplat import difference, hand_over, require_gsplat
from clgs.lab.bench.step import synthetic_trainer

LEAST_ALPHA, MOST_ALPHA, LEAST_TRANSMITTANCE = 1 / 255, 0.999, 1e-4
"""Constants of gsplat's rasteriser, version 1.5."""


@pytest.fixture(scope="module")
def view(device):
    trainer = synthetic_trainer(device, 600, (40, 32), 3)
    return hand_over(device, trainer.render_next(), trainer.dataset.train[0].camera)


def picture(screen, size, background):
    """All Gaussians over all pixels, front to back, in float64."""
    width, height = size
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    image, left = np.zeros((height, width, 3)), np.ones((height, width))
    open_ = np.ones((height, width), bool)
    for i in np.argsort(screen["depth"], kind="stable"):
        dx, dy = screen["mean"][i, 0] - x, screen["mean"][i, 1] - y
        xx, xy, yy = screen["conic"][i].astype(np.float64)
        sigma = 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy
        alpha = np.minimum(MOST_ALPHA, screen["opacity"][i] * np.exp(-sigma))
        inside = (np.abs(dx) <= screen["radii"][i, 0]) & (np.abs(dy) <= screen["radii"][i, 1])
        taken = open_ & inside & (sigma >= 0) & (alpha >= LEAST_ALPHA)
        after = left * (1 - alpha)
        open_ &= ~(taken & (after <= LEAST_TRANSMITTANCE))
        taken &= open_
        image += np.where(taken, alpha * left, 0)[..., None] * screen["color"][i]
        left = np.where(taken, after, left)
    return image + left[..., None] * background


def test_the_picture_is_ours(view):
    assert len(view.screen["depth"]) > 300
    assert view.image.max() > 0.2
    made = picture(view.screen, view.size, view.background)
    assert difference(made, view.image) < 1e-4


def test_gaussians_in_space_project_to_those_on_the_screen(view):
    seen = view.space["mean"] @ view.viewmat[:3, :3].T + view.viewmat[:3, 3]
    place = (seen / seen[:, 2:]) @ view.intrinsics.T
    found = [
        np.hypot(*(place[:, :2] - mean).T)[np.abs(seen[:, 2] - depth) < 1e-4].min()
        for mean, depth in zip(view.screen["mean"][:50], view.screen["depth"][:50], strict=True)
    ]
    assert max(found) < 1e-2
    np.testing.assert_allclose(np.linalg.norm(view.space["rotation"], axis=1), 1, atol=1e-5)
    assert ((view.space["opacity"] > 0) & (view.space["opacity"] <= 1)).all()


def test_without_gsplat_it_says_what_is_needed(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(UsageError, match=r"pip install .clgs\[gsplat\]"):
        require_gsplat()
