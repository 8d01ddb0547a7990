"""``clgs.torch`` in programs that use more of PyTorch than a loss and a backward pass."""

import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install clgs[torch]")

import clgs.torch as ours  # noqa: E402
from clgs.torch.tensors import ViewsCall  # noqa: E402
from tests.render.splat_scene import scene  # noqa: E402
from tests.torch.test_torch import tensors  # noqa: E402

TRAINED = ("means", "quats", "scales", "opacities", "colors", "viewmats", "backgrounds")


def leaves(rng, *of_scene, **how):
    """Arguments, those of TRAINED with a gradient."""
    given = tensors(scene(rng, *of_scene, **how))
    given["backgrounds"] = torch.rand(len(given["viewmats"]), 3)
    for name in TRAINED:
        given[name].requires_grad_()
    return given


def gradients(given, loss):
    return torch.autograd.grad(loss, [given[name] for name in TRAINED], allow_unused=True)


@pytest.fixture
def float64_by_default():
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


@pytest.mark.usefixtures("float64_by_default")
def test_any_default_dtype(rng):
    given = tensors(scene(rng))
    covars = torch.eye(3, dtype=torch.float32).mul(0.02).expand(40, 3, 3).clone().requires_grad_()
    for render_mode in ("RGB", "D", "RGB+ED"):
        image = ours.rasterization(
            **{**given, "quats": None, "scales": None}, covars=covars, render_mode=render_mode
        )[0]
        image.sum().backward()
        assert image.dtype == covars.grad.dtype == torch.float32
    names = "means", "quats", "scales", "viewmats", "Ks"
    means, *rest = (given[name] for name in names)
    radii, means2d, depths, conics, _ = ours.fully_fused_projection(means, None, *rest, 33, 27)
    _, ids, rows = ours.isect_tiles(means2d, radii, depths, 16, 3, 2)
    colors, opacities = (torch.stack([given[name]] * 2) for name in ("colors", "opacities"))
    lists = ours.isect_offset_encode(ids, 2, 3, 2), rows
    splats = means2d, conics, colors, opacities
    assert ours.rasterize_to_pixels(*splats, 33, 27, 16, *lists)[0].dtype == torch.float32
    assert ours.rate(means, 4.0).dtype == torch.float32


@pytest.mark.parametrize("count", [0, 40])
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("render_mode", ["RGB", "D", "RGB+ED"])
def test_no_cameras(rng, count, packed, render_mode):
    given = leaves(rng, count)
    for name in ("viewmats", "Ks", "backgrounds"):
        given[name] = given[name][:0]
    image, alpha, meta = ours.rasterization(**given, packed=packed, render_mode=render_mode)
    (image.sum() + alpha.sum()).backward()
    assert image.shape[:3] == (0, 27, 33)
    shape = (0,) if packed else (0, count)
    assert meta["tiles_per_gauss"].shape == shape
    assert dict(meta)["isect_offsets"].shape == (0, 2, 3)


def test_absolute_gradients_of_packed_rows_of_several_pictures(rng):
    given = tensors(scene(rng))
    names = "means", "quats", "scales", "viewmats", "Ks"
    means, *rest = (given[name] for name in names)
    _, cameras, gaussians, radii, means2d, depths, conics, _ = ours.fully_fused_projection(
        means, None, *rest, 33, 27, packed=True, opacities=given["opacities"]
    )
    _, ids, rows = ours.isect_tiles(
        means2d, radii, depths, 16, 3, 2, packed=True, n_images=2, image_ids=cameras
    )
    lists = ours.isect_offset_encode(ids, 2, 3, 2), rows
    splats = (
        means2d.requires_grad_(),
        conics,
        *(given[n][gaussians] for n in ("colors", "opacities")),
    )
    image = ours.rasterize_to_pixels(*splats, 33, 27, 16, *lists, packed=True, absgrad=True)[0]
    image.sum().backward()
    info = ours.rasterization(**given | {"means": means.requires_grad_()}, absgrad=True)
    info[2]["means2d"].retain_grad()
    info[0].sum().backward()
    assert torch.allclose(means2d.grad, info[2]["means2d"].grad, rtol=1e-4, atol=1e-5)
    assert torch.allclose(means2d.absgrad, info[2]["means2d"].absgrad, rtol=1e-4, atol=1e-5)


def test_results_may_be_changed_in_place(rng):
    given = leaves(rng)
    found = []
    for change in (lambda one: one * 2, lambda one: one.mul_(2)):
        image, alpha, _ = ours.rasterization(**given, render_mode="RGB+D")
        loss = change(image).square().sum() + change(alpha).square().sum()
        found.append(gradients(given, loss))
    for one, other in zip(*found, strict=True):
        assert torch.equal(one, other)


@pytest.mark.parametrize("loss", [torch.sum, lambda image: image.square().sum()])
def test_second_derivatives_are_refused(rng, loss):
    given = leaves(rng)
    image = ours.rasterization(**given)[0]
    (slope,) = torch.autograd.grad(loss(image), given["means"], create_graph=True)
    slope.mul_(2)  # first derivatives are as usual
    with pytest.raises(NotImplementedError, match="second derivatives are not offered"):
        (image.sum() + slope.square().sum()).backward()
    x = torch.randn(9, 3, requires_grad=True)
    for result in (ours.rate(x, 4.0), ours.spherical_harmonics(0, x, x[:, None]).sum()):
        (slope,) = torch.autograd.grad(result, x, create_graph=True)
        with pytest.raises(NotImplementedError, match="second derivatives are not offered"):
            slope.sum().backward()


def test_second_derivatives_by_one_input_are_refused_too(rng):
    """PyTorch leaves out what no path leads from to the inputs that are asked for."""
    given = leaves(rng)
    image = ours.rasterization(**given)[0]
    (slope,) = torch.autograd.grad(image.square().sum(), given["means"], create_graph=True)
    for name in ("means", "colors"):
        with pytest.raises(NotImplementedError, match="second derivatives are not offered"):
            torch.autograd.grad(slope.sum(), given[name], retain_graph=True)
    x = torch.randn(9, 3, requires_grad=True)
    with pytest.raises(NotImplementedError, match="second derivatives are not offered"):
        torch.autograd.functional.hvp(lambda one: ours.rate(one, 4.0), x, torch.ones(9, 3))


def test_first_derivatives_through_a_checkpoint_may_keep_their_graph(rng):
    given = leaves(rng)
    names, values = zip(*given.items(), strict=True)

    def draw(*tensors):
        return ours.rasterization(**dict(zip(names, tensors, strict=True)))[0]

    image = torch.utils.checkpoint.checkpoint(draw, *values, use_reentrant=False)
    (slope,) = torch.autograd.grad(image.sum(), given["means"], create_graph=True)
    (wanted,) = torch.autograd.grad(draw(*values).sum(), given["means"])
    assert torch.equal(slope, wanted)


def test_meta_is_stored_as_a_dictionary(rng, tmp_path):
    given = {name: one.detach() for name, one in leaves(rng).items() if torch.is_tensor(one)}
    rest = {name: one for name, one in leaves(rng).items() if not torch.is_tensor(one)}
    meta = ours.rasterization(**given, **rest)[2]
    torch.save(meta, tmp_path / "meta.pt")
    stored = torch.load(tmp_path / "meta.pt", weights_only=True)
    for found in (stored, meta.copy(), meta | {}):
        assert isinstance(found, dict)
        assert list(found) == list(meta)
        assert torch.equal(found["radii"], meta["radii"])


def test_the_backward_pass_ignores_autocast(rng):
    given = leaves(rng)
    found = []
    for enabled in (False, True):
        with torch.autocast("cpu", torch.bfloat16, enabled=enabled):
            image = ours.rasterization(**given)[0]
            found.append(gradients(given, image.square().sum()))
    for one, other in zip(*found, strict=True):
        assert torch.equal(one, other)


@pytest.mark.slow
def test_a_compiled_program_calls_it_as_it_is(rng):
    if not torch._dynamo.is_dynamo_supported():
        pytest.skip("torch.compile is not offered here")

    def loss(given):
        image, alphas, _ = ours.rasterization(**given)
        levels = ours.spherical_harmonics(0, given["means"], given["colors"][:, None] - 0.5)
        return (2 * image).sum() + alphas.square().mean() + levels.sum()

    given = leaves(rng)
    plain = loss(given)
    compiled = torch.compile(loss, backend="eager")(given)
    assert torch.equal(plain, compiled)
    for one, other in zip(gradients(given, plain), gradients(given, compiled), strict=True):
        assert torch.equal(one, other)


def test_a_negated_view_is_read_as_what_it_is(rng):
    given = tensors(scene(rng))
    wanted = ours.rasterization(**given)[0]
    given["means"] = torch.complex(given["means"], -given["means"]).conj().imag
    assert given["means"].is_neg()
    assert torch.equal(ours.rasterization(**given)[0], wanted)


@pytest.mark.parametrize("kind", [torch.Tensor.bfloat16, torch.Tensor.to_sparse])
def test_what_numpy_cannot_read_is_named(rng, kind):
    given = tensors(scene(rng))
    with pytest.raises(TypeError, match=r"means: torch\.\w+, torch.* shape \(40, 3\)"):
        ours.rasterization(**{**given, "means": kind(given["means"])})


def test_transforms_of_functions_are_refused(rng):
    given = tensors(scene(rng))

    def draw(means):
        return ours.rasterization(**{**given, "means": means})[0].sum()

    for transform in (torch.func.grad(draw), lambda means: torch.func.vmap(draw)(means[None])):
        with pytest.raises(NotImplementedError, match=r"means: torch.func's transforms are not"):
            transform(given["means"])


@pytest.mark.parametrize(
    ("changes", "error", "match"),
    [
        ({"dirs": [[0.0, 0.0, 1.0]]}, TypeError, "dirs: is list; give a tensor"),
        ({"coeffs": None}, TypeError, "coeffs: is None; give a tensor"),
        ({"coeffs": torch.zeros(3)}, ValueError, r"coeffs: shape is \(3,\), expected \(5, 4, 3\)"),
        ({"coeffs": torch.zeros(5, 1, 3)}, ValueError, r"coeffs: .* expected \(5, 4, 3\)"),
        ({"dirs": torch.zeros(5, 3).double()}, TypeError, "dirs: dtype is torch.float64"),
        ({"degrees_to_use": 1.0}, TypeError, r"degrees_to_use: is 1\.0; give 0 to 4"),
        ({"degrees_to_use": 5}, ValueError, "degrees_to_use: is 5, not 0 to 4"),
        ({"masks": torch.ones(5)}, TypeError, "masks: dtype is torch.float32, expected torch.bool"),
        ({"masks": torch.ones(2, 5).bool()}, ValueError, r"masks: shape is \(2, 5\)"),
    ],
)
def test_harmonics_that_are_refused(changes, error, match):
    given = {"degrees_to_use": 1, "dirs": torch.zeros(5, 3), "coeffs": torch.zeros(5, 4, 3)}
    with pytest.raises(error, match=match):
        ours.spherical_harmonics(**{**given, **changes})


def test_projections_that_are_refused(rng):
    given = tensors(scene(rng))
    means, *rest = (given[name] for name in ("means", "quats", "scales", "viewmats", "Ks"))
    for covars in (torch.zeros(40, 7), torch.eye(3).expand(40, 3, 3)):
        with pytest.raises(ValueError, match=r"covars: shape is .*, expected \(40, 6\)"):
            ours.fully_fused_projection(means, covars, None, None, *rest[2:], 33, 27)
    with pytest.raises(TypeError, match="means: is list; give a tensor"):
        ours.fully_fused_projection(means.tolist(), None, *rest, 33, 27)


def test_lists_and_pixels_that_are_refused():
    boxes = torch.zeros(2, 4, 2), torch.ones(2, 4, 2).int(), torch.ones(2, 4)
    with pytest.raises(ValueError, match=r"tile_size, .*: \(0, 3, 2\) are not above 0"):
        ours.isect_tiles(*boxes, 0, 3, 2)
    with pytest.raises(TypeError, match="means2d: is list; give a tensor"):
        ours.isect_tiles(boxes[0].tolist(), *boxes[1:], 16, 3, 2)
    packed = *(one.flatten(0, 1) for one in boxes), 16, 3, 2
    for ids, match in (
        (torch.zeros(3), r"shape is \(3,\)"),
        (torch.arange(8), r"others than 0 to 2 - 1"),
    ):
        with pytest.raises(ValueError, match="image_ids: .*" + match):
            ours.isect_tiles(*packed, packed=True, n_images=2, image_ids=ids)
    _, ids, rows = ours.isect_tiles(*boxes, 16, 3, 2)
    with pytest.raises(TypeError, match=r"isect_ids: dtype is torch\.int32, expected"):
        ours.isect_offset_encode(ids.int(), 2, 3, 2)
    for wrong, images, columns, match in (
        (ids, 1, 3, "beyond 1 images of 6 tiles"),
        (ids, 2, 1, "beyond 2 images of 2 tiles"),
        (-ids, 2, 3, "beyond 2 images of 6 tiles"),
        (ids.flip(0), 2, 3, "is not sorted"),
    ):
        with pytest.raises(ValueError, match="isect_ids: .*" + match):
            ours.isect_offset_encode(wrong, images, columns, 2)
    given = {
        "means2d": boxes[0], "conics": torch.ones(2, 4, 3), "colors": torch.ones(2, 4, 3),
        "opacities": torch.ones(2, 4), "image_width": 33, "image_height": 27, "tile_size": 16,
        "isect_offsets": ours.isect_offset_encode(ids, 2, 3, 2), "flatten_ids": rows,
    }  # fmt: skip
    ours.rasterize_to_pixels(**given)
    for name, value, error, match in (
        ("conics", None, TypeError, "is None; give a tensor"),
        ("colors", [1.0], TypeError, "is list; give a tensor"),
        ("flatten_ids", rows[None], ValueError, "shape is"),
        ("flatten_ids", rows.float(), TypeError, "dtype is torch.float32, expected torch.int32"),
        (
            "masks",
            torch.ones(2, 2, 3).int(),
            TypeError,
            "dtype is torch.int32, expected torch.bool",
        ),
        ("backgrounds", torch.ones(2, 3).double(), TypeError, "dtype is torch.float64"),
    ):
        with pytest.raises(error, match=f"{name}: {match}"):
            ours.rasterize_to_pixels(**{**given, name: value})


LOSSES = {
    "image": lambda given, image, meta: image.square().sum(),
    "and depths": lambda given, image, meta: image.square().sum() + meta["depths"].sum(),
    "and means": lambda given, image, meta: image.square().sum() + given["means"].sum(),
}
HOOKS = {"none": None, "new": lambda d: 2 * d, "in place": lambda d: d.mul_(2)}


@pytest.mark.parametrize("hook", HOOKS)
@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("packed", [False, True])
def test_backward_pass_that_was_begun_is_used_only_if_it_is_asked_for(
    rng, monkeypatch, hook, loss, packed
):
    given = leaves(rng, cameras=1)
    taken, usual = [], ViewsCall.take_begun

    def found(allowed):
        def take(call, passed):
            taken.append(usual(call, passed))
            return taken[-1] if allowed else None

        monkeypatch.setattr(ViewsCall, "take_begun", take)
        image, _, meta = ours.rasterization(**given, packed=packed)
        if HOOKS[hook]:
            meta["means2d"].register_hook(HOOKS[hook])
        whole = LOSSES[loss](given, image, meta)
        twice = [
            torch.autograd.grad(whole, [given[name] for name in TRAINED], retain_graph=True)
            for _ in range(2)
        ]
        assert all(torch.equal(*pair) for pair in zip(*twice, strict=True))
        return twice[0]

    assert all(torch.equal(*pair) for pair in zip(found(True), found(False), strict=True))
    used = hook == "none" and loss != "and depths"
    assert [one is not None for one in taken] == [used] * 4
