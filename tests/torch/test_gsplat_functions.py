"""The functions that gsplat's ``rasterization`` is made of, against its own PyTorch code."""

import math

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install clgs[torch]")
pytest.importorskip("gsplat", reason="gsplat is not installed: pip install gsplat")

from gsplat.cuda import _torch_impl as impl  # noqa: E402

import clgs.torch as ours  # noqa: E402
from tests.render.splat_scene import UPPER, scene  # noqa: E402
from tests.torch import gsplat_reference as theirs  # noqa: E402

SIZE = 33, 27
GRID = 3, 2  # tiles across and down


def close(found, wanted, limit=1e-4):
    return (found - wanted).norm() <= limit * wanted.norm()


@pytest.mark.parametrize("model", ["pinhole", "ortho", "fisheye"])
@pytest.mark.parametrize("compensated", [False, True])
@pytest.mark.parametrize("by_covariance", [False, True])
@pytest.mark.parametrize("packed", [False, True])
def test_projection(rng, model, compensated, by_covariance, packed):
    given = scene(rng, model=model)
    names = ("means", "quats", "scales", "viewmats", "Ks")
    found = []
    for dtype in (torch.float32, torch.float64):
        leaves = [torch.tensor(given[name], dtype=dtype)[None] for name in names]
        leaves = [one.requires_grad_() for one in leaves]
        means, quats, scales, *cameras = leaves
        covars = impl._quat_scale_to_covar_preci(quats, scales, True, False)[0]
        how = {"calc_compensations": compensated, "camera_model": model}
        if dtype == torch.float64:
            result = impl._fully_fused_projection(means, covars, *cameras, *SIZE, **how)
        else:
            shapes = (covars[..., UPPER[0], UPPER[1]], None, None)
            shapes = shapes if by_covariance else (None, quats, scales)
            means = (means, *shapes)
            result = ours.fully_fused_projection(*means, *cameras, *SIZE, packed=packed, **how)
            ids, result = result[:-5], result[-5:]
        found.append((result, leaves))
    (made, leaves), (wanted, leaves64) = found
    if packed:
        assert torch.equal(torch.stack(ids), (wanted[0] > 0).all(dim=-1).nonzero().T)
        wanted = [None if one is None else one[tuple(ids)] for one in wanted]
    drawn = (made[0] > 0).all(dim=-1)
    assert torch.equal(drawn, (wanted[0] > 0).all(dim=-1))
    assert drawn.sum() > 30
    assert torch.equal(made[0], wanted[0])
    assert (made[4] is not None) == compensated
    losses = [0, 0]
    for one, other in zip(made[1:], wanted[1:], strict=True):
        if one is not None:
            assert close(one[drawn], other[drawn], 1e-5)
            weight = torch.tensor(rng.normal(size=other[drawn].shape))
            losses = [loss + (v[drawn] * weight).sum()
                      for loss, v in zip(losses, (one, other), strict=True)]  # fmt: skip
    for loss in losses:
        loss.backward()
    for one, other in zip(leaves[:4], leaves64[:4], strict=True):
        assert close(one.grad, other.grad)


def test_boxes_of_given_opacities_end_where_alpha_is_below_the_cut(rng):
    given = {n: torch.tensor(v) for n, v in scene(rng).items() if isinstance(v, np.ndarray)}
    arguments = given["means"], None, given["quats"], given["scales"], given["viewmats"]
    arguments = (*arguments, given["Ks"], *SIZE)
    wide = ours.fully_fused_projection(*arguments)[0]
    opacities = torch.full((40,), 0.1).requires_grad_()
    tight = ours.fully_fused_projection(*arguments, calc_compensations=True, opacities=opacities)
    assert (tight[0] <= wide).all()
    assert (tight[0] < wide).any()
    both = ours.fully_fused_projection(*arguments, calc_compensations=True)[4]
    drawn = (tight[0] > 0).all(dim=-1)
    assert torch.allclose(tight[4][drawn], both[drawn], rtol=1e-5)


@pytest.mark.parametrize("tile_size", [16, 4])
def test_tile_lists(rng, tile_size):
    images, count = (2, 3), 50
    means2d = torch.tensor(rng.normal(20, 20, (*images, count, 2)), dtype=torch.float32)
    radii = torch.tensor(rng.integers(0, 20, (*images, count, 2)), dtype=torch.int32)
    depths = torch.tensor(rng.uniform(0.1, 1, (*images, count)), dtype=torch.float32)
    given = means2d, radii, depths, tile_size, *GRID
    counts, ids, rows = ours.isect_tiles(*given)
    wanted = impl._isect_tiles(*given)
    for one, other in zip((counts, ids, rows), wanted, strict=True):
        assert torch.equal(one, other)
    offsets = ours.isect_offset_encode(ids, 6, *GRID)
    assert torch.equal(offsets, impl._isect_offset_encode(ids, 6, *GRID))
    unsorted = ours.isect_tiles(*given, sort=False)
    assert torch.equal(unsorted[1], impl._isect_tiles(*given, sort=False)[1])
    flat = [one.flatten(0, 2) for one in given[:3]]
    image = torch.arange(6).repeat_interleave(count)
    packed = ours.isect_tiles(*flat, *given[3:], packed=True, n_images=6, image_ids=image,
                              gaussian_ids=torch.arange(count).repeat(6))  # fmt: skip
    assert torch.equal(packed[1], ids)
    assert torch.equal(packed[2], rows)
    with pytest.raises(ValueError, match="n_images"):
        ours.isect_tiles(*flat, *given[3:], packed=True)


def screen(rng, channels, batch=()):
    """What scenes are on the screens of two cameras each, as leaves, and their tile lists."""
    given = {n: torch.tensor(v) for n, v in scene(rng).items() if isinstance(v, np.ndarray)}
    given = {name: one.expand(*batch, *one.shape) for name, one in given.items()}
    images = *batch, 2
    radii, means2d, depths, conics, _ = ours.fully_fused_projection(
        given["means"], None, given["quats"], given["scales"], given["viewmats"], given["Ks"], *SIZE
    )
    colors = torch.tensor(rng.uniform(0, 1, (*images, 40, channels)), dtype=torch.float32)
    opacities = given["opacities"][..., None, :].expand(*images, 40)
    shade = torch.tensor(rng.uniform(0, 1, (*images, channels)), dtype=torch.float32)
    _, ids, rows = ours.isect_tiles(means2d, radii, depths, 16, *GRID)
    offsets = ours.isect_offset_encode(ids, math.prod(images), *GRID)
    offsets = offsets.reshape(*images, *offsets.shape[1:])
    leaves = [one.detach().clone() for one in (means2d, conics, colors, opacities, shade)]
    return [one.requires_grad_() for one in leaves], (*SIZE, 16, offsets, rows), depths, radii


@pytest.mark.parametrize("channels", [3, 32, 33, 128])
@pytest.mark.parametrize("batch", [(), (2,), (1, 2)])
def test_pixels(rng, channels, batch):
    leaves, lists, depths, radii = screen(rng, channels, batch)
    *splats, shade = leaves
    image, alpha = ours.rasterize_to_pixels(*splats, *lists, backgrounds=shade, absgrad=True)
    leaves64 = [one.detach().double().requires_grad_() for one in leaves]
    centre, conic, color, opacity, shade64 = leaves64
    sorted_by = [one.reshape(-1, *one.shape[len(batch) + 1 :])
                 for one in (centre, conic, opacity, depths, radii, color, shade64)]  # fmt: skip
    drawn = [theirs._blend(*one, *SIZE) for one in zip(*sorted_by, strict=True)]
    shape = *batch, 2, *SIZE[::-1], -1
    wanted = [torch.stack([one[i] for one in drawn]).reshape(shape) for i in (0, 1)]
    for one, other in zip((image, alpha), wanted, strict=True):
        assert (one - other).abs().max() < 1e-5
    weights = [torch.tensor(rng.normal(size=one.shape)) for one in wanted]
    for pair in ((image, alpha), wanted):
        sum((one * weight).sum() for one, weight in zip(pair, weights, strict=True)).backward()
    for one, other in zip(leaves, leaves64, strict=True):
        assert close(one.grad, other.grad)
    assert (splats[0].absgrad >= splats[0].grad.abs() * (1 - 1e-5)).all()


def test_packed_pixels_and_masks(rng):
    (*splats, shade), lists, _, _ = screen(rng, 3)
    image, alpha = ours.rasterize_to_pixels(*splats, *lists, backgrounds=shade)
    wanted = torch.autograd.grad(image.square().sum() + alpha.sum(), splats)
    flat = [one.detach().flatten(0, 1).requires_grad_() for one in splats]
    packed = ours.rasterize_to_pixels(*flat, *lists, backgrounds=shade, packed=True)
    assert torch.equal(packed[0], image)
    found = torch.autograd.grad(packed[0].square().sum() + packed[1].sum(), flat)
    for one, other in zip(found, wanted, strict=True):
        assert close(one, other.flatten(0, 1), 1e-6)
    masks = torch.ones(2, *GRID[::-1], dtype=torch.bool)
    masks[1, 0, 1] = False
    partly = ours.rasterize_to_pixels(*splats, *lists, backgrounds=shade, masks=masks)
    assert not partly[1][1, :16, 16:32].any()
    assert torch.equal(partly[0][1, :16, 16:32], shade[1].expand(16, 16, 3))
    assert torch.equal(partly[0][0], image[0])
    assert torch.equal(partly[0][1, :, :16], image[1, :, :16])


def test_what_is_refused(rng):
    (*splats, shade), (*size, offsets, rows), _, _ = screen(rng, 3)
    with pytest.raises(NotImplementedError, match="tile_size: 4 is not offered"):
        ours.rasterize_to_pixels(*splats, *SIZE, 4, offsets, rows)
    with pytest.raises(ValueError, match=r"flatten_ids: .* rows of another image"):
        ours.rasterize_to_pixels(*splats, *size, offsets, rows.flip(0) + 40)
    with pytest.raises(ValueError, match=r"isect_offsets: .* does not rise"):
        ours.rasterize_to_pixels(*splats, *size, offsets.flip(0), rows)
    with pytest.raises(ValueError, match="conics: shape"):
        ours.rasterize_to_pixels(splats[0], splats[1][:1], *splats[2:], *size, offsets, rows)
    with pytest.raises(ValueError, match="backgrounds: shape"):
        ours.rasterize_to_pixels(*splats, *size, offsets, rows, backgrounds=shade[:1])
    given = {n: torch.tensor(v) for n, v in scene(rng).items() if isinstance(v, np.ndarray)}
    arguments = given["means"], None, given["quats"], given["scales"], given["viewmats"]
    for name, value in (("camera_model", "ftheta"), ("sparse_grad", True)):
        with pytest.raises(NotImplementedError, match=name):
            ours.fully_fused_projection(*arguments, given["Ks"], *SIZE, **{name: value})
