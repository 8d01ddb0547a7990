"""The reference without truncation is what its definition says, and is kept by content."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.constants import ALPHA_MAX
from clgs.lab.scenes import anchor_scene
from clgs.lab.selftest import reference_render
from clgs.lab.selftest.reference_render import backward_reference
from clgs.reference.blend import COLOR_LIMIT

SIZE = 21
BACKGROUND = np.float32([0.2, 0.5, 0.9])


@pytest.fixture(scope="module")
def case():
    scene, camera = anchor_scene(60, SIZE, seed=3)
    # some Gaussians saturate
    scene.mlps.head("opacity")["output_bias"][:3] = 4.0
    return scene, camera.pack(0.2)


def render(case):
    return reference_render.render_untruncated(*case, (SIZE, SIZE), BACKGROUND)


def test_image_is_that_of_all_pairs(case):
    """Every Gaussian in every pixel, front to back, by the formulas."""
    frame = render(case)
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    left, image = np.ones((SIZE, SIZE)), np.zeros((3, SIZE, SIZE))
    drawn = np.flatnonzero(frame.projected.extent[:, 0] > 0)
    saturated = 0
    for i in drawn[np.argsort(frame.projected.depth[drawn], kind="stable")]:
        dx, dy = x - frame.projected.mean2d[i, 0], y - frame.projected.mean2d[i, 1]
        r1, slope, r2 = frame.projected.whitening[i]
        power = 0.5 * ((dx * r1) ** 2 + ((dy - slope * dx) * r2) ** 2)
        alpha = frame.gaussians.opacity[i] * np.exp(-power)
        saturated += int((alpha > ALPHA_MAX).sum())
        alpha = np.minimum(alpha, ALPHA_MAX)
        image += np.clip(frame.gaussians.color[i], -COLOR_LIMIT, COLOR_LIMIT)[:, None, None] * (
            alpha * left
        )
        left = left * (1 - alpha)
    wanted = image + frame.background[:, None, None] * left
    assert saturated > 0
    # what is left out: at most every Gaussian's RESOLUTION; and rounding
    assert np.abs(frame.image - wanted).max() <= 1e-14


def test_gradient_is_that_of_the_image(case, rng):
    scene, _ = case
    d_image = rng.normal(size=(3, SIZE, SIZE))
    gradient = backward_reference(render(case), d_image, 0.0)["d_weights"]
    step, weights = 1e-3, scene.mlps.flat
    # color biases: no decision depends on them
    start = weights.size - sum(a.size for a in scene.mlps.head("covariance").values()) - 1
    for index in range(start - 4, start):
        values = []
        old = weights[index]
        for sign in (1, -1):
            weights[index] = old + np.float32(sign * step)
            values.append((float(weights[index]), np.sum(d_image * render(case).image)))
        weights[index] = old
        (high, above), (low, below) = values
        assert (above - below) / (high - low) == pytest.approx(gradient[index], rel=1e-5)


def test_reference_is_kept(case, rng, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("CLGS_CACHE", str(tmp_path / "cache"))
    d_image = rng.normal(size=(3, SIZE, SIZE)).astype(np.float32)
    arguments = (*case, (SIZE, SIZE), BACKGROUND, d_image)
    first, again = (reference_render.cached_reference(*arguments) for _ in range(2))
    assert capsys.readouterr().err.count("reference without truncation") == 1
    assert set(first) == {"image", "d_offset", "d_feature", "d_scaling", "d_weights"}
    assert all(np.array_equal(first[name], again[name]) for name in first)
    other = (*arguments[:3], BACKGROUND[::-1].copy(), d_image)
    assert not np.array_equal(reference_render.cached_reference(*other)["image"], first["image"])
