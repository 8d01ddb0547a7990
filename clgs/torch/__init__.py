"""``import clgs.torch as gsplat``: the rasteriser for PyTorch, on any OpenCL device.

:func:`rasterization` and :func:`spherical_harmonics` have the arguments, defaults and results of
gsplat 1.5.3, and gradients by autograd; ``DefaultStrategy`` and ``MCMCStrategy`` are gsplat's own,
if it is installed, and run on our ``meta``. Tensors are float32 on the CPU; a CPU device reads and
writes their memory where it lies. :func:`decode_anchors`, :func:`quantize` and :func:`rate` train
Voxel-GS scenes. ``torch.utils.checkpoint`` and ``no_grad`` work as usual.
"""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
import torch
from torch import Tensor

from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.render.rasterization import ALPHA_MAX, default_device, lens_of, refuse
from clgs.render.splat_arguments import check_arguments, check_numbers, check_size
from clgs.render.splat_meta import Meta, meta_of
from clgs.render.splat_record import SMALLEST_ALPHA
from clgs.torch.anchors import DecodedAnchors as DecodedAnchors
from clgs.torch.anchors import decode_anchors as decode_anchors
from clgs.torch.anchors import quantize as quantize
from clgs.torch.anchors import rate as rate
from clgs.torch.functions import Blend, Harmonics, Project
from clgs.torch.tensors import Call, checked, host_of, packed_rows

STRATEGIES = ("DefaultStrategy", "MCMCStrategy", "Strategy")


def __getattr__(name: str) -> Any:
    """The strategies of gsplat, imported at first use."""
    if name not in STRATEGIES:
        raise AttributeError(f"module 'clgs.torch' has no attribute {name!r}")
    from gsplat import strategy

    return getattr(strategy, name)


def spherical_harmonics(
    degrees_to_use: int, dirs: Tensor, coeffs: Tensor, masks: Tensor | None = None
) -> Tensor:
    """Sums of spherical harmonics of degree 0 to 4, as of ``gsplat.spherical_harmonics``.

    Args:
        degrees_to_use: 0 to 4.
        dirs: (..., 3) float32, of any length; 0 has no gradient.
        coeffs: (..., K, 3) float32, of which the first (degree + 1)^2 are used.
        masks: (...) bool; results are 0 if false.

    Returns:
        (..., 3) float32.

    Raises:
        ValueError, TypeError: an argument has another shape or dtype.
    """
    shape = dirs.shape[:-1]
    if dirs.shape != (*shape, 3) or coeffs.shape != (*shape, coeffs.shape[-2], 3):
        raise ValueError(f"dirs, coeffs: shapes are {tuple(dirs.shape)}, {tuple(coeffs.shape)}")
    flat = dirs.reshape(-1, 3), coeffs.reshape(-1, *coeffs.shape[-2:])
    result: Tensor = Harmonics.apply(degrees_to_use, *flat)
    result = result.reshape(*shape, 3)
    return result if masks is None else torch.where(masks[..., None], result, 0.0)


def rasterization(  # noqa: PLR0913  gsplat's arguments
    means: Tensor,
    quats: Tensor | None,
    scales: Tensor | None,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,  # noqa: N803  the field's name of intrinsics
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: Tensor | None = None,
    render_mode: str = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: str = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: str = "pinhole",
    segmented: bool = False,
    covars: Tensor | None = None,
    with_ut: bool = False,
    with_eval3d: bool = False,
    radial_coeffs: Tensor | None = None,
    tangential_coeffs: Tensor | None = None,
    thin_prism_coeffs: Tensor | None = None,
    ftheta_coeffs: Any = None,
    rolling_shutter: Any = None,
    viewmats_rs: Tensor | None = None,
    *,
    device: Device | None = None,
    alpha_max: float = ALPHA_MAX,
    options: RenderOptions = DEFAULT,
) -> tuple[Tensor, Tensor, Meta]:
    """Draw Gaussians as cameras see them; see :func:`clgs.rasterization` for the arguments.

    Gradients flow to means, quats and scales or covars, opacities, colors, viewmats and
    backgrounds; ``meta["means2d"]`` retains its own, and ``absgrad``, as gsplat's does.

    Raises:
        NotImplementedError: an argument asks for what is not offered; names it.
        TypeError, ValueError: an argument cannot be used; names it and its shape or device.
    """
    arguments = locals()
    refuse(arguments)
    check_size(width, height)
    check_numbers(near_plane=near_plane, far_plane=far_plane, radius_clip=radius_clip, eps2d=eps2d)
    names = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks", "backgrounds")
    hosts = {name: checked(name, arguments[name]) for name in (*names, "covars")}
    given = check_arguments(**hosts, sh_degree=sh_degree, render_mode=render_mode)
    lens = lens_of(arguments)
    call = Call(
        device or default_device(), given, lens, (width, height), render_mode != "RGB",
        alpha_max, options, absgrad,
    )  # fmt: skip
    b, c = given.viewmats.shape[:2]
    flat = [
        None if one is None else one.reshape(b, *one.shape[len(given.batch) :])
        for one in (means, None if covars is not None else quats,
                    None if covars is not None else scales, covars, opacities, viewmats)
    ]  # fmt: skip
    seen: tuple[Tensor, ...] = Project.apply(call, *flat)
    centres, whitening, depths, shown, extents = seen
    reach = np.ceil(host_of(extents)).astype(np.int32)  # PyTorch's threads would wait for OpenCL's
    if packed:
        call.rows = torch.from_numpy(np.flatnonzero(reach[..., 0]))
        means2d = packed_rows(call, centres)
    else:
        means2d = centres.reshape(*given.batch, *centres.shape[1:])
    color = _colors(call, flat[0], colors, flat[5], sh_degree, render_mode)
    shade = torch.zeros(given.backgrounds.shape)
    if backgrounds is not None and "RGB" in render_mode:
        own = backgrounds.reshape(b, c, -1)
        shade = torch.cat([own, shade[..., own.shape[-1] :]], dim=-1)
    call.centres = weakref.ref(means2d)
    image, alphas = Blend.apply(call, means2d, whitening, depths, shown, extents, color, shade)
    if "ED" in render_mode:
        divisor = alphas.clamp(min=SMALLEST_ALPHA)
        image = torch.cat([image[..., :-1], image[..., -1:] / divisor], dim=-1)
    meta = _meta(call, packed, means2d, torch.from_numpy(reach), depths, whitening, shown)
    return (
        image.reshape(*given.batch, *image.shape[1:]),
        alphas.reshape(*given.batch, *alphas.shape[1:]),
        meta,
    )


def _colors(
    call: Call,
    means: Tensor | None,
    colors: Tensor,
    viewmats: Tensor | None,
    sh_degree: int | None,
    render_mode: str,
) -> Tensor:
    """What is blended, (B, 1 or C, N, D): the colors, those of the harmonics, or nothing."""
    given = call.given
    stored = colors.reshape(given.colors.shape)
    if "RGB" not in render_mode:
        return torch.zeros(*stored.shape[:3], 0)
    if sh_degree is None:
        return stored
    assert means is not None
    assert viewmats is not None
    centre = torch.linalg.inv(viewmats.to(torch.float32))[..., :3, 3]
    seen = [
        Harmonics.apply(
            sh_degree, means[batch] - centre[batch, number], stored[batch, number % stored.shape[1]]
        )
        for batch, number in call.pictures()
    ]
    every = torch.stack(seen) if seen else torch.zeros(0, stored.shape[2], 3)
    shape = (*given.viewmats.shape[:2], stored.shape[2], 3)
    return torch.clamp_min(every.reshape(shape) + 0.5, 0.0)


def _meta(
    call: Call,
    packed: bool,
    means2d: Tensor,
    radii: Tensor,
    depths: Tensor,
    whitening: Tensor,
    opacities: Tensor,
) -> Meta:
    """The third result: tensors, of which those of the tile lists are made when asked for."""
    batch, count = call.given.batch, call.given.means.shape[1]
    cameras = call.given.viewmats.shape[1]
    host = meta_of(call.device, call.drawn, batch, cameras, count, call.size, packed)

    def shaped(tensor: Tensor) -> Tensor:
        return packed_rows(call, tensor) if packed else tensor.reshape(*batch, *tensor.shape[1:])

    def conics() -> Tensor:
        r1, lean, r2 = whitening.unbind(-1)
        return shaped(torch.stack([r1**2 + (lean * r2) ** 2, -lean * r2**2, r2**2], dim=-1))

    def tensor_of(key: str) -> Tensor | None:
        value = host[key]
        return None if value is None else torch.from_numpy(np.ascontiguousarray(value))

    known = {name: value for name, value in host.items() if not name.endswith("_ids")}
    known |= {name: tensor_of(name) for name in ("batch_ids", "camera_ids", "gaussian_ids")}
    known["means2d"] = means2d
    lazy = ("tiles_per_gauss", "isect_ids", "flatten_ids", "isect_offsets")
    makers = {name: lambda name=name: tensor_of(name) for name in lazy}
    rest = {
        "radii": lambda: shaped(radii),
        "depths": lambda: shaped(depths),
        "opacities": lambda: shaped(opacities),
        "conics": conics,
    }
    return Meta(known, {**makers, **rest})
