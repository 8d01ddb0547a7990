"""Tier 3: the float64 gradient of the whole pipeline against central differences.

Differences of the free render, with its own decisions: a coordinate counts where no decision (drawn
slots, ReLUs, alpha cuts, stops) changes within the step, which nearly all do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from clgs.constants import LOG_SCALE_LIMIT
from clgs.lab.scenes import anchor_scene
from clgs.lab.selftest.reference_render import ReferenceFrame, backward_reference, wide
from clgs.reference import blend, cull, loss, mlp, neural, project, tiles
from tests.compare import central_difference

SIZE = 24
VOLUME_WEIGHT = 3.0
BACKGROUND = np.array([0.3, 0.6, 0.1])
SAMPLES = {"offset": 16, "feature": 16, "scaling": 16, "weights": 32}


@dataclass
class Problem:
    """A scene in float64, what it is seen with, and the random linear loss."""

    host: dict[str, np.ndarray]
    camera: np.ndarray
    d_image: np.ndarray

    def render(self, host: dict[str, np.ndarray]) -> ReferenceFrame:
        """All stages in float64."""
        visible = cull.forward(host["position"], host["scaling"], self.camera)
        activations = mlp.forward(
            host["feature"], host["position"], visible, host["weights"], self.camera
        )
        anchors = visible, host["position"], host["offset"], host["scaling"]
        gaussians = neural.forward(activations.output, *anchors)
        shape = gaussians.mean, gaussians.scale, gaussians.rotation
        projected = project.forward(*shape, gaussians.opacity, self.camera)
        size = SIZE, SIZE
        lists = tiles.forward(projected, gaussians.opacity, *size)
        light = gaussians.color, gaussians.opacity
        blended = blend.forward(projected, *light, lists, BACKGROUND, size)
        return ReferenceFrame(
            host,
            self.camera,
            BACKGROUND,
            activations,
            gaussians,
            projected,
            lists,
            blended.decisions,
            blended.image,
        )

    def value(self, frame: ReferenceFrame) -> float:
        volume = VOLUME_WEIGHT * loss.volume(frame.gaussians.scale, 1.0)[0]
        return float(np.sum(self.d_image * frame.image)) + volume


def decisions_of(frame: ReferenceFrame) -> list[bytes]:
    """All that a step may not change."""
    scaling = frame.scene["scaling"]
    decided = [
        frame.activations.visible,
        frame.activations.hidden > 0,
        frame.gaussians.slot,
        frame.lists.gaussian,
        frame.decisions.contributed,
        frame.decisions.saturated,
        np.abs(scaling) <= LOG_SCALE_LIMIT,
    ]
    return [np.ascontiguousarray(array).tobytes() for array in decided]


@pytest.fixture(scope="module", params=range(3))
def problem(request):
    scene, camera = anchor_scene(60, SIZE, 20 + request.param)
    if request.param == 1:  # wide enough that the Jacobian's clamp and the stop take part
        scene.anchors.scaling[:] += 1.5
        scene.anchors.position[:, :2] *= 1.4
    host = wide(scene)
    if request.param == 2:  # clamped log scales have no gradient
        host["scaling"][0, 1], host["scaling"][1, 4] = -LOG_SCALE_LIMIT - 1, -LOG_SCALE_LIMIT - 2
    camera = replace(camera, cx=0.45 * SIZE, cy=0.55 * SIZE)
    packed = camera.pack(0.2).astype(np.float64)
    d_image = np.random.default_rng(request.param).normal(size=(3, SIZE, SIZE))
    return Problem(host, packed, d_image)


def sample(name: str, gradient: np.ndarray) -> list[tuple[int, ...]]:
    """Coordinates: half of them those of the largest gradients, half any."""
    rng, count = np.random.default_rng(1), SAMPLES[name] // 2
    largest = np.argsort(-np.abs(gradient).ravel())[: 10 * count]
    chosen = [*rng.choice(largest, count, False), *rng.choice(gradient.size, count, False)]
    return [np.unravel_index(int(i), gradient.shape) for i in chosen]


@pytest.mark.parametrize("name", SAMPLES)
def test_gradient_of_the_whole_pipeline(problem, name):
    frame = problem.render(problem.host)
    gradient = backward_reference(frame, problem.d_image, VOLUME_WEIGHT)[f"d_{name}"]
    before, changed = decisions_of(frame), set()
    indices = sample(name, gradient)
    now = [0]

    def value(x: np.ndarray) -> float:
        moved = problem.render({**problem.host, name: x})
        if decisions_of(moved) != before:
            changed.add(now[0] // 2)
        now[0] += 1
        return problem.value(moved)

    numeric = central_difference(value, problem.host[name], 1e-6, indices)
    valid = np.array([i not in changed for i in range(len(indices))])
    # a weight moves every Gaussian at once
    assert valid.mean() > (0.5 if name == "weights" else 0.8)
    found = np.array([gradient[index] for index in indices])
    # doubles: 1e-16 of a loss of 100 over the step is 1e-8
    error = np.linalg.norm((found - numeric)[valid])
    assert error <= 1e-6 * np.linalg.norm(found[valid]) + 1e-8 * valid.sum() ** 0.5
    assert np.abs(found[valid]).max() > 1e-3
