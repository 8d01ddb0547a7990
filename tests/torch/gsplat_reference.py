"""gsplat's ``rasterization`` in float64, by its own PyTorch code (``_torch_impl``).

Its blending needs CUDA, so that the sum over pixels is written out here from its kernel: every
Gaussian over every pixel, in the order of depths.
"""

from typing import Any

import torch
from gsplat.cuda import _torch_impl as impl
from torch import Tensor

ALPHA_THRESHOLD, ALPHA_MAX, STOP = 1 / 255, 0.999, 1e-4


def rasterization(  # noqa: PLR0913  gsplat's arguments
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,  # noqa: N803
    width: int,
    height: int,
    sh_degree: int | None = None,
    backgrounds: Tensor | None = None,
    render_mode: str = "RGB",
    rasterize_mode: str = "classic",
    camera_model: Any = "pinhole",
    covars: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Colors (..., C, H, W, X) and alphas (..., C, H, W, 1)."""
    if covars is None:
        covars = impl._quat_scale_to_covar_preci(quats, scales, True, False)[0]
    radii, means2d, depths, conics, share = impl._fully_fused_projection(
        means, covars, viewmats, Ks, width, height,
        calc_compensations=rasterize_mode == "antialiased", camera_model=camera_model,
    )  # fmt: skip
    opacities = opacities[..., None, :].expand(depths.shape)
    opacities = opacities if share is None else opacities * share
    per_camera = colors.ndim == means.ndim + (sh_degree is not None) + 1
    if not per_camera:
        axis = means.ndim - 2
        shape = (*colors.shape[:axis], viewmats.shape[-3], *colors.shape[axis:])
        colors = colors.unsqueeze(axis).expand(shape)
    if sh_degree is not None:
        dirs = means[..., None, :, :] - torch.inverse(viewmats)[..., :3, 3][..., None, :]
        colors = torch.clamp_min(impl._spherical_harmonics(sh_degree, dirs, colors) + 0.5, 0.0)
    shown = [colors] * ("RGB" in render_mode) + [depths[..., None]] * (render_mode != "RGB")
    channels = torch.cat(shown, dim=-1)
    shade = torch.zeros(*depths.shape[:-1], channels.shape[-1], dtype=means.dtype)
    if backgrounds is not None and "RGB" in render_mode:
        shade = torch.cat([backgrounds, shade[..., backgrounds.shape[-1] :]], dim=-1)
    sizes = depths.shape[:-1]
    flat = [
        one.reshape(-1, *one.shape[len(sizes) :])
        for one in (means2d, conics, opacities, depths, radii, channels, shade)
    ]
    drawn = [_blend(*one, width, height) for one in zip(*flat, strict=True)]
    image = torch.stack([one[0] for one in drawn]).reshape(*sizes, height, width, -1)
    alpha = torch.stack([one[1] for one in drawn]).reshape(*sizes, height, width, 1)
    if "ED" in render_mode:
        depth = image[..., -1:] / alpha.clamp(min=1e-10)
        image = torch.cat([image[..., :-1], depth], dim=-1)
    return image, alpha


def _blend(
    centre: Tensor,
    conic: Tensor,
    opacity: Tensor,
    depth: Tensor,
    radii: Tensor,
    channel: Tensor,
    shade: Tensor,
    width: int,
    height: int,
) -> tuple[Tensor, Tensor]:
    order = torch.argsort(depth, stable=True)
    order = order[(radii[order] > 0).all(dim=-1)]
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    pixel = torch.stack([x, y], dim=-1).reshape(-1, 2) + 0.5
    dx, dy = (centre[order][:, None] - pixel).unbind(-1)
    a, b, c = conic[order][:, None].unbind(-1)
    sigma = 0.5 * (a * dx**2 + c * dy**2) + b * dx * dy
    alpha = torch.clamp_max(opacity[order, None] * torch.exp(-sigma), ALPHA_MAX)
    alpha = torch.where((alpha >= ALPHA_THRESHOLD) & (sigma >= 0), alpha, 0.0)
    after = torch.cumprod(1 - alpha, dim=0)
    alpha = torch.where(after > STOP, alpha, 0.0)
    after = torch.cumprod(1 - alpha, dim=0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
    left = after[-1] if len(order) else torch.ones(len(pixel), dtype=centre.dtype)
    return (alpha * before).T @ channel[order] + left[:, None] * shade, 1 - left
