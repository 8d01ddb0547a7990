"""Gaussians to the screen: the first half of ``rasterization``, and gsplat's function of it."""

from __future__ import annotations

from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np
import torch
from torch import Tensor

from clgs.render.rasterization import default_device
from clgs.render.rasterization import rasterization as rasterization_of_numpy
from clgs.render.splat_arguments import check_arguments, checked_lens
from clgs.torch.functions import Project
from clgs.torch.tensors import ViewsCall, check_shapes, checked, eager, needed, tensor_rows

SIGNATURE = signature(rasterization_of_numpy)
PARAMETERS = {name: one for name, one in SIGNATURE.parameters.items() if name != "later"}
BY_ORDER = [name for name, one in PARAMETERS.items() if one.kind is one.POSITIONAL_OR_KEYWORD]
NEEDED = {name for name, one in PARAMETERS.items() if one.default is one.empty}
USUAL = {name: one.default for name, one in PARAMETERS.items()} | {"later": {}}
REACH = 3.33
"""Where gsplat's boxes of Gaussians without opacities end, standard deviations."""

NAMES = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks", "backgrounds")


def bound_arguments(*arguments: Any, **others: Any) -> dict[str, Any]:
    """All arguments of ``rasterization`` by name; TypeError if they do not fit."""
    found = {**dict(zip(BY_ORDER, arguments, strict=False)), **others}
    known = NEEDED <= found.keys() <= PARAMETERS.keys()
    if known and len(found) == len(arguments) + len(others):  # faster than what tells what is wrong
        return {**USUAL, **found}
    bound = SIGNATURE.bind(*arguments, **others)
    bound.apply_defaults()
    return bound.arguments


def checked_call(
    given: dict[str, Any], reach: float | None = None
) -> tuple[ViewsCall, list[Tensor | None]]:
    """Check the arguments of ``rasterization``; ``reach``: see ``CameraModel``.

    Returns:
        What the call shares, and what :class:`Project` takes last: means, quats, scales,
        covars, opacities and viewmats.
    """
    lens = replace(checked_lens(given), reach=reach)
    by_covariance = given["covars"] is not None
    hosts = {name: checked(name, given[name]) for name in (*NAMES, "covars")}
    arguments = check_arguments(
        **hosts, sh_degree=given["sh_degree"], render_mode=given["render_mode"]
    )
    device, size = given["device"] or default_device(), (given["width"], given["height"])
    call = ViewsCall(device, arguments, lens, size, given["options"], given["packed"])
    unused = ("quats", "scales") if by_covariance else ("covars",)
    names = ("means", "quats", "scales", "covars", "opacities", "viewmats")
    return call, [None if name in unused else given[name] for name in names]


def conics_of(whitening: Tensor) -> Tensor:
    """Inverse covariances (..., 3), xx, xy, yy, of whitening factors."""
    r1, lean, r2 = whitening.unbind(-1)
    return torch.stack([r1**2 + (lean * r2) ** 2, -lean * r2**2, r2**2], dim=-1)


@eager
def fully_fused_projection(  # noqa: PLR0913  gsplat's arguments
    means: Tensor,
    covars: Tensor | None,
    quats: Tensor | None,
    scales: Tensor | None,
    viewmats: Tensor,
    Ks: Tensor,  # noqa: N803  the field's name of intrinsics
    width: int,
    height: int,
    eps2d: float = 0.3,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    packed: bool = False,
    sparse_grad: bool = False,
    calc_compensations: bool = False,
    camera_model: str = "pinhole",
    opacities: Tensor | None = None,
) -> tuple[Tensor | None, ...]:
    """Project Gaussians, as ``gsplat.fully_fused_projection``; units as in :func:`rasterization`.

    Args:
        means: (..., N, 3) float32.
        covars: (..., N, 6) float32, xx, xy, xz, yy, yz, zz, or None.
        quats: (..., N, 4) float32, if there are no covars.
        scales: (..., N, 3) float32, if there are no covars.
        viewmats: (..., C, 4, 4).
        Ks: (..., C, 3, 3).
        width: pixels.
        height: pixels.
        eps2d: blur, square pixels.
        near_plane: smallest depth.
        far_plane: largest depth.
        radius_clip: pixels.
        packed: whether to list only what is drawn.
        sparse_grad: False.
        calc_compensations: whether to return the share of the opacity that the blur leaves.
        camera_model: "pinhole", "ortho" or "fisheye", which is equidistant.
        opacities: (..., N) float32, 0 to 1; boxes end where alpha is below 1/255; if None,
            3.33 standard deviations from the centre.

    Returns:
        radii (..., C, N, 2) int32, 0 if culled; means2d (..., C, N, 2), depths (..., C, N), conics
        (..., C, N, 3), float32, 0 if culled; compensations (..., C, N) float32 or None. If packed:
        batch, camera and Gaussian (M,) int64 of each of M rows, then the same by row.

    Raises:
        NotImplementedError: an argument asks for what is not offered; names it.
        TypeError, ValueError: an argument cannot be used; names it and its shape.
    """
    batch = needed("means", means).shape[:-1]
    if covars is not None:
        check_shapes({"covars": (needed("covars", covars), (*batch, 6), torch.float32)})
        covars = covars[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].unflatten(-1, (3, 3))
    shown = means.new_ones(batch) if opacities is None else needed("opacities", opacities)
    given = bound_arguments(
        means, quats, scales, shown, shown[..., None], viewmats, Ks, width, height,
        near_plane, far_plane, radius_clip, eps2d, packed=packed, sparse_grad=sparse_grad,
        rasterize_mode="antialiased" if calc_compensations else "classic",
        camera_model=camera_model, covars=covars,
    )  # fmt: skip
    call, tensors = checked_call(given, REACH if opacities is None else None)
    centres, whitening, depths, left, _ = Project.apply(call, None, *tensors)
    batch = call.given.batch
    if opacities is not None:
        left = left / shown.reshape(left.shape[0], 1, left.shape[2]).clamp(min=1e-30)
    radii = torch.from_numpy(call.radii)
    results = [tensor_rows(call.rows, one) for one in (radii, depths, conics_of(whitening), left)]
    if call.rows is None:
        results = [one.reshape(*batch, *one.shape[1:]) for one in results]
    results.insert(1, centres)
    compensations = results[4] if calc_compensations else None
    if call.rows is None:
        return *results[:4], compensations
    cameras, count = call.radii.shape[1:3]
    pictures, gaussian_ids = np.divmod(call.rows, count)
    ids = *np.divmod(pictures, cameras), gaussian_ids
    return *(torch.from_numpy(one) for one in ids), *results[:4], compensations
