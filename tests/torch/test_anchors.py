"""Voxel-GS scenes in ``clgs.torch``: autograd's rules, float64, and what is refused."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install clgs[torch]")

import clgs  # noqa: E402
import clgs.torch as ours  # noqa: E402
from clgs.reference import quantize, rate  # noqa: E402
from tests.compare import relative_l2  # noqa: E402
from tests.ops.cases.project import camera_at  # noqa: E402
from tests.render.test_decoded_anchors import (  # noqa: E402
    BY,
    FIELDS,
    in_order,
    random_gradients,
    reference_gradients,
    some_scene,
)


def tensors(scene):
    """The arguments before the camera, those that are trained with a gradient."""
    made = {name: torch.tensor(array) for name, array in scene.anchors.items()}
    made["weights"] = torch.tensor(scene.mlps.flat)
    for name in BY:
        made[name].requires_grad_()
    return made


def weighted(found, d):
    return sum((torch.tensor(d[name]) * getattr(found, name)).sum() for name in FIELDS)


def test_gradients_match_float64_and_the_numpy_form(rng):
    scene, camera = some_scene(rng), camera_at()
    plain = clgs.decode_anchors(scene, camera)
    d = random_gradients(rng, plain)
    given = tensors(scene)
    found = ours.decode_anchors(**given, camera=camera)
    for name in found._fields:
        assert np.array_equal(getattr(found, name).detach().numpy(), getattr(plain, name)), name
    weighted(found, d).backward()
    wanted, order = plain.backward(*d.values()), in_order(scene, camera, plain)
    expected = reference_gradients(scene, camera, {name: d[name][order] for name in FIELDS})
    assert given["position"].grad is None
    for name in BY:
        assert np.array_equal(given[name].grad.numpy(), wanted[name]), name
        assert relative_l2(given[name].grad.numpy(), expected[name]) <= 1e-5, name


@pytest.mark.filterwarnings("ignore:Input:UserWarning")  # gradcheck asks for float64
def test_gradcheck(rng):
    """Central differences in float32 along random directions."""
    scene, camera = some_scene(rng, 8), camera_at()
    given = tensors(scene)
    d = random_gradients(rng, clgs.decode_anchors(scene, camera))
    directions = {name: torch.tensor(rng.normal(size=given[name].shape)).float() for name in BY}

    def loss(*steps):
        moved = {
            name: given[name].detach() + step * directions[name]
            for name, step in zip(BY, steps, strict=True)
        }
        found = ours.decode_anchors(given["position"], **moved, camera=camera)
        return weighted(found, d)

    steps = [torch.zeros((), requires_grad=True) for _ in BY]
    assert torch.autograd.gradcheck(loss, steps, eps=1e-3, atol=5e-3, rtol=1e-2)


def test_checkpoint_and_no_grad(rng):
    from torch.utils.checkpoint import checkpoint

    camera = camera_at()
    plain = tensors(some_scene(rng))
    checked = {name: one.detach().clone() for name, one in plain.items()}
    for name in BY:
        checked[name].requires_grad_()

    def draw(*values):
        return ours.decode_anchors(*values, camera).means.square().sum()

    draw(*plain.values()).backward()
    checkpoint(draw, *checked.values(), use_reentrant=False).backward()
    for name in ("offset", "scaling"):
        assert plain[name].grad.any()
        assert torch.equal(plain[name].grad, checked[name].grad)
    with torch.no_grad():
        assert not draw(*plain.values()).requires_grad


def test_what_changed_since_is_refused(rng):
    given = tensors(some_scene(rng))
    found = ours.decode_anchors(**given, camera=camera_at())
    with torch.no_grad():
        given["offset"] += 1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        found.means.sum().backward()


def test_rounding_is_the_references_and_passes_gradients(rng):
    x = torch.tensor(rng.normal(0, 3, (40, 10, 3)).astype(np.float32), requires_grad=True)
    q = torch.tensor(2.0 ** rng.integers(-3, 4, x.shape)).float()
    weight = torch.tensor(rng.normal(size=x.shape)).float()
    for scale, wanted in (
        (8.0, quantize.forward(x.detach().numpy(), 8.0)),
        (q, quantize.elements(x.detach().numpy(), q.numpy())),
    ):
        x.grad = None
        rounded = ours.quantize(x, scale)
        assert np.array_equal(rounded.detach().numpy(), wanted)
        (rounded * weight).sum().backward()
        assert torch.equal(x.grad, weight)


@pytest.mark.parametrize("form", ["channel", "pooled"])
@pytest.mark.parametrize("q", [1.0, 8.0])
def test_rate_matches_float64(rng, form, q):
    x = torch.tensor(rng.laplace(0, 2, (500, 2, 3)).astype(np.float32), requires_grad=True)
    symbols = rate.symbols(x.detach().numpy(), q).reshape(500, -1)
    bits = ours.rate(x, q, form)
    assert abs(bits.item() - rate.forward(symbols, form)) <= 1e-5 * bits.item()
    (3 * bits).backward()
    wanted = 3 * q * rate.backward(symbols, form)
    assert relative_l2(x.grad.numpy(), wanted.reshape(x.shape)) <= 1e-5


def test_rate_of_nothing_is_0():
    x = torch.zeros(0, 6, requires_grad=True)
    bits = ours.rate(x, 1.0)
    bits.backward()
    assert bits.item() == 0
    assert x.grad.shape == (0, 6)


@pytest.mark.parametrize(
    ("changes", "error", "match"),
    [
        ({"offset": np.zeros((8, 10, 3))}, TypeError, "offset: is ndarray; give a tensor"),
        ({"feature": None}, TypeError, "feature: is None; give a tensor"),
        ({"scaling": torch.zeros(8, 6).double()}, TypeError, "scaling: dtype is float64"),
        ({"scaling": torch.zeros(8, 6, device="meta")}, ValueError, "scaling: is on meta"),
        ({"scaling": torch.zeros(8, 5)}, ValueError, r"scaling: shape is \(8, 5\), expected"),
        ({"offset": torch.full((8, 10, 3), torch.inf)}, ValueError, r"offset: \(8, 10, 3\) has"),
        ({"weights": torch.zeros(3)}, ValueError, r"weights: shape is \(3,\), expected \(13710\)"),
        ({"position": torch.zeros(8, 3, requires_grad=True)}, ValueError, "position: .* fixed"),
        ({"camera": np.eye(4)}, TypeError, "camera: is ndarray, Camera is needed"),
        ({"near": -1.0}, ValueError, "near: -1.0 is not"),
    ],
)
def test_what_decoding_refuses(rng, changes, error, match):
    given = {
        "position": torch.zeros(8, 3),
        "offset": torch.zeros(8, 10, 3),
        "feature": torch.zeros(8, 50),
        "scaling": torch.zeros(8, 6),
        "weights": torch.zeros(13710),
        "camera": camera_at(),
    }
    with pytest.raises(error, match=match):
        ours.decode_anchors(**{**given, **changes})


@pytest.mark.parametrize("function", [ours.quantize, ours.rate])
def test_what_rounding_and_rate_refuse(function):
    x = torch.zeros(4, 3)
    for q in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match=r"q: .* is not a finite number above 0"):
            function(x, q)
    with pytest.raises(TypeError, match="q: is str; give a number"):
        function(x, "8")
    with pytest.raises(TypeError, match="x: dtype is float64"):
        function(x.double(), 1.0)
    with pytest.raises(ValueError, match=r"x: \(4, 3\) has numbers that are not finite"):
        function(x * torch.nan, 1.0)


def test_shapes_that_do_not_fit():
    with pytest.raises(ValueError, match=r"q: shape is \(3,\), expected \(4, 3\)"):
        ours.quantize(torch.zeros(4, 3), torch.ones(3))
    with pytest.raises(ValueError, match=r"q: \(3,\) has numbers that are not above 0"):
        ours.quantize(torch.zeros(3), torch.tensor([1.0, 0.0, 2.0]))
    with pytest.raises(ValueError, match=r"x: shape is \(\), expected \(rows"):
        ours.rate(torch.tensor(1.0), 1.0)
    with pytest.raises(ValueError, match="form is 'laplace'; use channel or pooled"):
        ours.rate(torch.zeros(3, 2), 1.0, "laplace")
