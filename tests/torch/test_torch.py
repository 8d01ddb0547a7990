"""``clgs.torch``: autograd's rules, and what is refused."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install clgs[torch]")

import clgs  # noqa: E402
import clgs.torch as ours  # noqa: E402
from tests.render.splat_scene import scene  # noqa: E402


def tensors(given):
    return {n: torch.tensor(v) if isinstance(v, np.ndarray) else v for n, v in given.items()}


def test_gradcheck(rng):
    """Central differences in float32, of a scene in which every pixel sees every Gaussian."""
    given = tensors(scene(rng, 4, 1, sh_degree=1))
    given["means"] *= 0.2
    given["scales"] = given["scales"] * 0 + torch.tensor([1.5, 2.0, 2.5])
    given["opacities"] = given["opacities"] * 0.3 + 0.2
    names = ("means", "quats", "scales", "opacities", "colors")

    def draw(*values):
        arguments = {**given, **dict(zip(names, values, strict=True)), "width": 4, "height": 4}
        arguments["Ks"] = torch.tensor([[[4.0, 0, 2], [0, 4.0, 2], [0, 0, 1]]])
        image, alpha, _ = ours.rasterization(**arguments, render_mode="RGB+ED")
        return image, alpha

    values = [given[name].requires_grad_() for name in names]
    assert torch.autograd.gradcheck(draw, values, eps=1e-2, atol=2e-3, rtol=2e-2)


def test_checkpoint_and_no_grad(rng):
    given = tensors(scene(rng))
    means = given.pop("means")

    def draw(means):
        return ours.rasterization(means, **given)[0]

    plain, checked = means.clone().requires_grad_(), means.clone().requires_grad_()
    draw(plain).square().sum().backward()
    from torch.utils.checkpoint import checkpoint

    checkpoint(draw, checked, use_reentrant=False).square().sum().backward()
    assert torch.equal(plain.grad, checked.grad)
    with torch.no_grad():
        assert not draw(plain).requires_grad


def test_has_the_bits_of_the_numpy_form(rng):
    given = scene(rng, sh_degree=2)
    image, alpha, meta = clgs.rasterization(**given, render_mode="RGB+D", absgrad=True)
    weight = rng.normal(size=image.shape).astype(np.float32)
    made = meta["record"].backward(weight)
    values = tensors(given)
    trained = ("means", "quats", "scales", "opacities", "colors")
    for name in trained:
        values[name].requires_grad_()
    picture, alphas, info = ours.rasterization(**values, render_mode="RGB+D", absgrad=True)
    info["means2d"].retain_grad()
    (picture * torch.tensor(weight)).sum().backward()
    assert np.abs(picture.detach().numpy() - image).max() < 1e-6
    assert np.array_equal(alphas.detach().numpy(), alpha)
    for name in trained:
        close = np.linalg.norm(values[name].grad.numpy() - made[name]) / np.linalg.norm(made[name])
        assert close < 1e-5, name
    drawn = meta["camera_ids"], meta["gaussian_ids"]
    assert np.allclose(info["means2d"].grad.numpy(), made["means2d"][drawn], rtol=1e-4, atol=1e-5)
    assert np.allclose(
        info["means2d"].absgrad.numpy(), made["absgrad"][drawn], rtol=1e-4, atol=1e-5
    )
    assert meta.keys() - {"record"} == info.keys()


def test_meta_is_a_dictionary_of_all_that_is_made_when_asked_for(rng):
    meta = ours.rasterization(**tensors(scene(rng)))[2]
    assert len(meta) == len(dict(meta)) == len(list(meta.items()))
    assert dict(meta)["gaussian_ids"] is meta["gaussian_ids"]
    meta["loss"] = 1.0
    del meta["radii"]
    assert {"loss", "depths"} <= set(meta)
    assert "radii" not in meta
    with pytest.raises(KeyError, match="radii"):
        del meta["radii"]


def test_gradients_of_some_results_alone(rng):
    """What the loss does not depend on counts as zeros, which nobody makes."""
    given = scene(rng)
    _, alpha, meta = clgs.rasterization(**given, render_mode="RGB+D")
    zeros = np.zeros((2, 27, 33, 4), np.float32)
    made = meta["record"].backward(zeros, np.ones_like(alpha))
    values = tensors(given)
    for name in ("means", "opacities", "viewmats"):
        values[name] = values[name].float().requires_grad_()
    ours.rasterization(**values, render_mode="RGB+D")[1].sum().backward()
    for name in ("means", "opacities", "viewmats"):
        grad = values[name].grad.numpy()
        assert np.linalg.norm(grad - made[name]) < 1e-5 * np.linalg.norm(made[name]), name
    assert not values["viewmats"].grad[:, 3].any()


def test_gradient_of_a_depth_alone(rng):
    values = tensors(scene(rng))
    means = values["means"].requires_grad_()
    depths = ours.fully_fused_projection(
        means, None, *(values[name] for name in ("quats", "scales", "viewmats", "Ks")), 33, 27
    )[2]
    depths.sum().backward()
    wanted = (depths > 0).float().T @ values["viewmats"][:, 2, :3].float()
    assert torch.allclose(means.grad, wanted, rtol=1e-5)


def test_what_changed_since_is_refused(rng):
    given = tensors(scene(rng))
    given["means"].requires_grad_()
    image = ours.rasterization(**given)[0]
    with torch.no_grad():
        given["means"] += 1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.sum().backward()


@pytest.mark.parametrize(
    ("changes", "error", "match"),
    [
        ({"means": np.zeros((40, 3), np.float32)}, TypeError, "means: is ndarray; give a tensor"),
        ({"means": torch.zeros(40, 3, dtype=torch.float64)}, TypeError, "means: dtype is float64"),
        ({"means": torch.zeros(40, 3, device="meta")}, ValueError, "means: is on meta"),
        ({"sparse_grad": True}, NotImplementedError, "sparse_grad"),
        ({"rays": torch.zeros(1)}, NotImplementedError, "rays"),
        ({"global_z_order": False}, NotImplementedError, "global_z_order"),
        ({"far": 1.0}, TypeError, "no argument 'far'"),
        ({"opacities": torch.full((40,), torch.nan)}, ValueError, "opacities"),
        ({"means": torch.zeros(3, 40)}, ValueError, r"means: .* \(3, 40\), expected \(..., N, 3\)"),
        ({"colors": torch.zeros(40, 16, 3)}, ValueError, "colors: .* give sh_degree if"),
        ({"sh_degree": 3}, ValueError, "colors: .*; colors that are no harmonics: sh_degree=None"),
        ({"opacities": torch.full((40,), 3.0)}, ValueError, "outside of 0 to 1; logits: sigmoid"),
    ],
)
def test_what_is_refused(rng, changes, error, match):
    with pytest.raises(error, match=match):
        ours.rasterization(**{**tensors(scene(rng)), **changes})


@pytest.mark.parametrize(
    ("count", "others", "match"),
    [
        (9, {"width": 5}, "multiple values for argument 'width'"),
        (8, {}, "missing a required argument: 'height'"),
        (40, {}, "too many positional arguments"),
        (9, {"later": {}}, "no argument 'later'"),
    ],
)
def test_arguments_that_do_not_fit(rng, count, others, match):
    order = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks", "width", "height")
    given = tensors(scene(rng))
    values = [given[name] for name in order] + [0.01] * 40
    with pytest.raises(TypeError, match=match):
        ours.rasterization(*values[:count], **others)


def test_tensors_of_one_number_are_numbers(rng):
    given = tensors(scene(rng))
    plain = ours.rasterization(**given, near_plane=0.5)[0]
    numbers = {name: torch.tensor(given.pop(name)) for name in ("width", "height")}
    assert torch.equal(
        ours.rasterization(**given, **numbers, near_plane=torch.tensor(0.5))[0], plain
    )


def test_nothing_to_draw(rng):
    given = tensors(scene(rng, 0, 2))
    image, alpha, meta = ours.rasterization(**given)
    assert image.shape == (2, 27, 33, 3)
    assert not alpha.any()
    assert meta["means2d"].shape == (0, 2)


def test_defaults_of_a_later_gsplat_are_accepted(rng):
    given = tensors(scene(rng))
    later = {"tile_size": None, "return_normals": False, "extra_signals": None}
    assert torch.equal(ours.rasterization(**given, **later)[0], ours.rasterization(**given)[0])


def test_strategies_are_those_of_gsplat():
    with pytest.raises(AttributeError, match="no attribute 'rasterize'"):
        _ = ours.rasterize
