"""``clgs.jax``: the pictures and gradients of the NumPy form, under jit, grad and vmap."""

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="JAX is not installed: pip install clgs[jax]")

import clgs  # noqa: E402
import clgs.jax as ours  # noqa: E402
from tests.render.splat_scene import scene  # noqa: E402


@pytest.mark.parametrize(
    ("by_covars", "model"), [(False, "pinhole"), (True, "pinhole"), (False, "fisheye")]
)
def test_has_the_pictures_and_gradients_of_the_numpy_form(rng, by_covars, model):
    given = scene(rng, model=model) | {"camera_model": model}
    given["backgrounds"] = rng.uniform(0, 1, (2, 3)).astype(np.float32)
    if by_covars:
        axes = rng.normal(0, 0.2, (40, 3, 3))
        given["covars"] = (axes @ axes.swapaxes(-1, -2)).astype(np.float32)
        given.update(quats=None, scales=None)
    image, alpha, meta = clgs.rasterization(**given, render_mode="RGB+D")
    weight = rng.normal(size=image.shape).astype(np.float32)
    wanted = meta["record"].backward(weight, np.ones_like(alpha))
    arrays = {name: value for name, value in given.items() if isinstance(value, np.ndarray)}
    rest = {name: value for name, value in given.items() if name not in arrays}

    def loss(arrays):
        picture, alphas = ours.rasterization(**arrays, **rest, render_mode="RGB+D")
        return (picture * weight).sum() + alphas.sum(), (picture, alphas)

    made, (picture, alphas) = jax.jit(jax.grad(loss, has_aux=True))(arrays)
    assert np.array_equal(picture, image)
    assert np.array_equal(alphas, alpha)
    assert not np.asarray(made.pop("Ks")).any()
    for name, gradient in made.items():
        assert np.array_equal(gradient, wanted[name]), name


def test_vmap(rng):
    given = scene(rng)
    means = np.stack([given.pop("means"), scene(rng)["means"]])
    drawn = jax.vmap(lambda one: ours.rasterization(means=one, **given)[0])(means)
    for one, picture in zip(means, drawn, strict=True):
        assert np.array_equal(picture, clgs.rasterization(means=one, **given)[0])


@pytest.mark.parametrize(
    ("changes", "error", "match"),
    [
        ({"means": np.full((40, 3), np.nan, np.float32)}, ValueError, "means: .* not finite"),
        ({"means": np.zeros((40, 2), np.float32)}, ValueError, r"means: shape is \(40, 2\)"),
        ({"viewmats": [[1.0]]}, TypeError, "viewmats: is list"),
        ({"quats": None}, TypeError, "quats: is NoneType"),
        ({"width": 0}, ValueError, "width: 0"),
        ({"sparse_grad": True}, NotImplementedError, "sparse_grad"),
        ({"far": 1.0}, TypeError, "'far'"),
    ],
)
def test_what_is_refused(rng, changes, error, match):
    with pytest.raises(error, match=match):
        ours.rasterization(**{**scene(rng), **changes})


def test_what_is_refused_of_arrays_that_are_traced(rng):
    given = scene(rng)
    means = given.pop("means")

    def loss(means):
        return ours.rasterization(means, **given)[0].sum()

    with pytest.raises(ValueError, match=r"opacities: shape is \(40,\), expected \(39,\)"):
        jax.grad(loss)(means[1:])
    with pytest.raises(RuntimeError, match=r"means: .* not finite"):
        jax.grad(loss)(means * np.float32(np.nan))
