"""``import clgs.torch as gsplat``: the rasteriser for PyTorch, on any OpenCL device.

:func:`rasterization` and :func:`spherical_harmonics` have the arguments, defaults and results of
gsplat 1.5.3, and gradients by autograd; ``DefaultStrategy`` and ``MCMCStrategy`` are gsplat's own,
if it is installed, and run on our ``meta``. Tensors are float32 on the CPU; a CPU device reads and
writes their memory where it lies. :func:`decode_anchors`, :func:`quantize` and :func:`rate` train
Voxel-GS scenes. ``torch.utils.checkpoint`` and ``no_grad`` work as usual.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import partial, wraps
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from clgs.ops.project import Projected
from clgs.render.rasterization import rasterization as rasterization_of_numpy
from clgs.render.splat_meta import RasterizationMeta, meta_of
from clgs.render.splat_record import SMALLEST_ALPHA
from clgs.torch.anchors import DecodedAnchors as DecodedAnchors
from clgs.torch.anchors import decode_anchors as decode_anchors
from clgs.torch.anchors import quantize as quantize
from clgs.torch.anchors import rate as rate
from clgs.torch.functions import Blend, Harmonics, Project
from clgs.torch.pixels import isect_offset_encode as isect_offset_encode
from clgs.torch.pixels import isect_tiles as isect_tiles
from clgs.torch.pixels import rasterize_to_pixels as rasterize_to_pixels
from clgs.torch.projection import bound_arguments, checked_call, conics_of
from clgs.torch.projection import fully_fused_projection as fully_fused_projection
from clgs.torch.tensors import (
    BlendCall,
    ViewsCall,
    check_shapes,
    eager,
    host_of,
    needed,
    tensor_rows,
)

HOST_ARRAYS = ("batch_ids", "camera_ids", "gaussian_ids", "tiles_per_gauss", "isect_ids",
               "flatten_ids", "isect_offsets")  # fmt: skip
"""What ``meta`` has of :func:`clgs.rasterization`'s."""

STRATEGIES = ("DefaultStrategy", "MCMCStrategy", "Strategy")


def __getattr__(name: str) -> Any:
    """The strategies of gsplat, imported at first use."""
    if name not in STRATEGIES:
        raise AttributeError(f"module 'clgs.torch' has no attribute {name!r}")
    from clgs.torch import strategies

    return getattr(strategies, name)


@eager
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
    shape = needed("dirs", dirs).shape[:-1]
    if isinstance(degrees_to_use, bool) or not isinstance(degrees_to_use, int):
        raise TypeError(f"degrees_to_use: is {degrees_to_use!r}; give 0 to 4")
    if not 0 <= degrees_to_use <= 4:
        raise ValueError(f"degrees_to_use: is {degrees_to_use}, not 0 to 4")
    count = max((degrees_to_use + 1) ** 2, *needed("coeffs", coeffs).shape[-2:-1], 0)
    check_shapes(
        {
            "dirs": (dirs, (*shape, 3), torch.float32),
            "coeffs": (coeffs, (*shape, count, 3), torch.float32),
            "masks": (masks, shape, torch.bool),
        }
    )
    flat = dirs.reshape(-1, 3), coeffs.reshape(-1, count, 3)
    result: Tensor = Harmonics.apply(degrees_to_use, *flat)
    result = result.reshape(*shape, 3)
    return result if masks is None else torch.where(masks[..., None], result, 0.0)


@eager
@wraps(rasterization_of_numpy, assigned=())
def rasterization(*arguments: Any, **others: Any) -> tuple[Tensor, Tensor, RasterizationMeta]:
    """Draw Gaussians as cameras see them; arguments as of :func:`clgs.rasterization`, of tensors.

    Gradients flow to means, quats and scales or covars, opacities, colors, viewmats and
    backgrounds; ``meta["means2d"]`` retains its own, and ``absgrad``, as gsplat's does.

    Raises:
        NotImplementedError: an argument asks for what is not offered; names it.
        TypeError, ValueError: an argument cannot be used; names it and its shape or device.
    """
    given = {
        name: value.item() if isinstance(value, Tensor) and not value.ndim else value
        for name, value in bound_arguments(*arguments, **others).items()
    }
    render_mode = given["render_mode"]
    call, tensors = checked_call(given)
    batch, (b, c) = call.given.batch, call.given.viewmats.shape[:2]
    shade = given["means"].new_zeros(call.given.backgrounds.shape)
    if given["backgrounds"] is not None and "RGB" in render_mode:
        own = given["backgrounds"].reshape(b, c, given["backgrounds"].shape[-1])
        shade = torch.cat([own, shade[..., own.shape[-1] :]], dim=-1)
    how = call.options, render_mode != "RGB", given["alpha_max"], given["absgrad"]
    pictures = *batch, c
    blend = BlendCall(call.device, call.size, *how, call.given.backgrounds, pictures, seen=call)
    painted, recorded = [], torch.is_grad_enabled()

    def begin(found: list[Projected]) -> None:
        """Begin to draw, within the projection: its gradients are added after the colors'."""
        with torch.set_grad_enabled(recorded):
            painted.append(_colors(call, given))
        usual = painted[0] is given["colors"]
        blend.colors = call.given.colors if usual else host_of(painted[0])
        for (batch, number), one in zip(product(range(b), range(c)), found, strict=True):
            blend.draw(batch, number, one)

    means2d, whitening, depths, left, extents = Project.apply(call, begin, *tensors)
    blend.centres = weakref.ref(means2d)
    meta = _meta(call, blend, means2d, depths, whitening, left)
    image, alphas = Blend.apply(blend, means2d, whitening, depths, left, extents, *painted, shade)
    if "ED" in render_mode:
        divisor = alphas.clamp(min=SMALLEST_ALPHA)
        image = torch.cat([image[..., :-1], image[..., -1:] / divisor], dim=-1)
    return image, alphas, meta


def _colors(call: ViewsCall, given: dict[str, Any]) -> Tensor:
    """What is blended: the colors as given, or (B, 1 or C, N, D), harmonics' or none."""
    colors: Tensor = given["colors"]
    stored, flat = call.given.colors.shape, call.given.viewmats.shape
    if "RGB" not in given["render_mode"]:
        return colors.new_zeros(*stored[:3], 0)
    if given["sh_degree"] is None:
        return colors
    centre = torch.linalg.inv(given["viewmats"].reshape(flat).to(torch.float32))[..., :3, 3]
    means, sh = given["means"].reshape(call.given.means.shape), colors.reshape(stored)
    seen = [
        Harmonics.apply(
            given["sh_degree"], means[batch] - centre[batch, number], sh[batch, number % stored[1]]
        )
        for batch, number in product(*map(range, flat[:2]))
    ]
    every = torch.stack(seen) if seen else colors.new_zeros(0, stored[2], 3)
    return torch.clamp_min(every.reshape(*flat[:2], stored[2], 3) + 0.5, 0.0)


def _meta(
    call: ViewsCall,
    blend: BlendCall,
    means2d: Tensor,
    depths: Tensor,
    whitening: Tensor,
    opacities: Tensor,
) -> RasterizationMeta:
    """The third result: tensors, of which those of the tile lists are made when asked for."""
    batch, count = call.given.batch, call.given.means.shape[1]
    cameras = call.given.viewmats.shape[1]

    def radii() -> npt.NDArray[np.int32]:
        return call.radii.reshape(call.radii.shape[0] * cameras, count, 2)

    host = meta_of(call.device, blend.drawn, batch, cameras, count, call.size, call.packed, radii)

    def shaped(tensor: Tensor) -> Tensor:
        rows = tensor_rows(call.rows, tensor)
        return rows if call.packed else rows.reshape(*batch, *tensor.shape[1:])

    def tensor_of(key: str) -> Tensor | None:
        value = host[key]
        return None if value is None else torch.from_numpy(np.ascontiguousarray(value))

    makers: dict[str, Callable[[], Tensor | None]] = {
        **{name: partial(tensor_of, name) for name in HOST_ARRAYS},
        "radii": lambda: shaped(torch.from_numpy(call.radii)),
        "depths": lambda: shaped(depths),
        "opacities": lambda: shaped(opacities),
        "conics": lambda: shaped(conics_of(whitening)),
    }
    known = {name: host[name] for name in host if name not in makers and name != "means2d"}
    return RasterizationMeta({**known, "means2d": means2d}, makers)
