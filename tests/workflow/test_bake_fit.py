"""The fit of ordinary Gaussians to observations of neural ones."""

from __future__ import annotations

import numpy as np

from clgs.reference.general.splats import basis
from clgs.reference.project import rotation_matrix
from clgs.workflow.bake_fit import LEAST_WEIGHT, Observation, fit, harmonics, quaternions

COUNT, VIEWS = 40, 60


def truth(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Gaussians whose shape and opacity no view changes, colors of degree 2."""
    rotation = rng.normal(size=(COUNT, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    sh = rng.normal(0, 0.1, (COUNT, 9, 3))
    scale = np.sort(rng.uniform(0.01, 0.3, (COUNT, 3)), axis=1)
    mean, opacity = rng.normal(size=(COUNT, 3)), rng.uniform(0.05, 0.95, COUNT)
    return {"mean": mean, "scale": scale, "rotation": rotation, "opacity": opacity, "sh": sh}


def observations(given: dict[str, np.ndarray], rng: np.random.Generator) -> list[Observation]:
    """Half of the Gaussians per view, seen from random sides; Gaussian n has the slot 2 n + 1."""
    found = []
    for _ in range(VIEWS):
        seen = np.flatnonzero(rng.random(COUNT) < 0.5)
        direction = rng.normal(size=(len(seen), 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        color = 0.5 + np.einsum("nc,nci->ni", basis(direction, 9), given["sh"][seen])
        arrays = (
            *(rng.uniform(1, 9, len(seen)), direction, given["mean"][seen]),
            *(given["scale"][seen], given["rotation"][seen], color, given["opacity"][seen]),
        )
        found.append(Observation(2 * seen + 1, *(np.asarray(a, np.float32) for a in arrays)))
    return found


def test_what_no_view_changes_is_found_again(rng):
    given = truth(rng)
    views = observations(given, rng)
    found = fit(lambda: views, 2 * COUNT, 2)
    assert len(found) == COUNT
    assert np.allclose(found.mean, given["mean"], atol=1e-6)
    # float32 scales, squared, and their square roots
    assert np.allclose(np.exp(found.log_scale), given["scale"], rtol=2e-4)
    turned = rotation_matrix(found.rotation.astype(np.float64))
    axes = rotation_matrix(given["rotation"])
    aligned = np.abs(np.einsum("nik,nik->nk", turned, axes))
    assert np.allclose(aligned, 1, atol=1e-3)
    assert np.allclose(1 / (1 + np.exp(-found.opacity)), given["opacity"], atol=1e-5)
    # the ridge takes a little from all but the constant
    assert np.abs(found.sh - given["sh"]).max() < 0.1
    assert np.abs(found.sh - given["sh"]).mean() < 0.02


def test_what_contributes_next_to_nothing_goes(rng):
    given = truth(rng)
    views = observations(given, rng)
    for view in views:
        view.weight[view.slot == 7] = 0.5 * LEAST_WEIGHT
    assert len(fit(lambda: views, 2 * COUNT, 0)) == COUNT - 1
    assert len(fit(lambda: [], 10, 3)) == 0


def test_quaternions_of_matrices(rng):
    unit = rng.normal(size=(1000, 4))
    unit[:8] = np.repeat(np.eye(4), 2, axis=0)  # half turns, too
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    found = quaternions(rotation_matrix(unit))
    assert np.allclose(np.abs(np.sum(found * unit, axis=1)), 1, atol=1e-12)


def test_harmonics_are_those_of_the_reference(rng):
    direction = rng.normal(size=(200, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for degree in range(4):
        found = harmonics(direction.astype(np.float32), degree)
        assert np.allclose(found, basis(direction, (degree + 1) ** 2), atol=2e-6)
