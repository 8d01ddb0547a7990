"""The functions of autograd: projection, blending, harmonics."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from clgs.opencl.array import DeviceArray
from clgs.ops.general import harmonics, views
from clgs.ops.general.channels import ChannelGradients
from clgs.ops.project import Projected
from clgs.render import channel_picture
from clgs.render.rasterization import default_device
from clgs.torch.tensors import (
    BlendCall,
    ViewsCall,
    gather_later,
    host_of,
    packed_rows,
    stacked,
    tensor_like,
    unpacked_rows,
)


def once(backward: Callable[..., Any]) -> Callable[..., Any]:
    """A backward pass in float32 whose own derivatives are refused, not taken for zeros.

    ``backward`` receives the context, the saved tensors, and the gradients.
    """

    @wraps(backward)
    def checked(ctx: Any, *d: Tensor | None) -> Any:
        saved = ctx.saved_tensors  # asks whether they changed; checkpoints let it be read once
        if not torch.is_grad_enabled() and not torch.is_autocast_enabled("cpu"):
            return backward(ctx, saved, *d)  # usual, and faster so
        with torch.no_grad(), torch.autocast("cpu", enabled=False):
            found = backward(ctx, saved, *d)
        if not torch.is_grad_enabled():
            return found
        sources = [one for one in (*saved, *d) if one is not None and one.requires_grad]
        return Refuse.apply(len(sources), *sources, *found)

    return checked


class Refuse(torch.autograd.Function):  # type: ignore[misc]  # torch is Any
    """Gradients as they are, which depend on the first ``count`` tensors; they have no gradient."""

    @staticmethod
    def forward(ctx: Any, count: int, *tensors: Tensor | None) -> tuple[Tensor | None, ...]:
        """Copy, so that they may be changed in place."""
        return tuple(None if one is None else one.clone() for one in tensors[count:])

    @staticmethod
    def backward(ctx: Any, *d: Tensor) -> tuple[Tensor | None, ...]:
        """Nobody computes it."""
        raise NotImplementedError(
            "clgs.torch: second derivatives are not offered; .detach() the gradients"
        )


class Project(torch.autograd.Function):  # type: ignore[misc]  # torch is Any
    """Gaussians to centres, whitening factors, depths, opacities and extents, (B, C, N, ...).

    Centres are those of what is drawn alone, (M, 2), if the call is packed, else (..., C, N, 2).
    Tensors are those of the caller, (..., N, ...): a view would cost a node of autograd.
    """

    @staticmethod
    def forward(
        ctx: Any,
        call: ViewsCall,
        begin: Callable[[list[Projected]], None] | None,
        means: Tensor,
        quats: Tensor | None,
        scales: Tensor | None,
        covars: Tensor | None,
        opacities: Tensor,
        viewmats: Tensor,
    ) -> tuple[Tensor, ...]:
        """Project, and ``begin`` to draw; returns centres, factors, depths, opacities, extents."""
        device, given = call.device, call.given
        shape = given.scales if given.covars is None else given.covars
        assert shape is not None
        for batch, number in product(*map(range, given.viewmats.shape[:2])):
            if number == 0:
                call.splats.append(
                    views.Splats(
                        device.share(given.means[batch]),
                        device.share(shape[batch]),
                        None if given.quats is None else device.share(given.quats[batch]),
                        device.share(given.opacities[batch]),
                    )
                )
            near = call.lens.near
            matrices = given.viewmats[batch, number], given.Ks[batch, number]
            camera = device.share(views.pack_camera(*matrices, call.size, near))
            call.cameras.append(camera)
            none = device.empty((len(call.splats[batch]), 0))
            with device.stage("views forward"):
                call.projected.append(
                    views.forward(device, call.splats[batch], camera, call.lens, none, call.options)
                )
        sizes = given.viewmats.shape[0], given.viewmats.shape[1], given.means.shape[1]
        names = {"mean2d": 2, "whitening": 3, "depth": None, "opacity": None, "extent": 2}
        gather = gather_later(device, call.projected, names, sizes)
        try:
            given.check_colors()
            if begin is not None:  # the device blends while the host goes on; no number disturbs it
                begin(call.projected)
            results = list(gather().values())
            depths = results[2]
            if not np.isfinite(np.vdot(depths, depths)):  # a number may be of no use: which?
                given.check_values()
        except ValueError:
            device.finish()  # it reads memory of the caller
            raise
        call.centres, call.extents = results[0], results[4]
        if call.packed:
            call.rows = np.flatnonzero(call.extents.view(np.int64) != 0)  # of pairs: faster
        shape_of_centres = (-1, 2) if call.packed else (*given.batch, *call.centres.shape[1:])
        results[0] = packed_rows(call.rows, call.centres).reshape(shape_of_centres)
        results = [torch.from_numpy(one) for one in results]
        ctx.call, ctx.by_covariance = call, covars is not None
        call.want_camera = ctx.needs_input_grad[7]
        given_too = means, quats, scales, covars, opacities, viewmats  # must not have changed
        ctx.save_for_backward(results[1], results[4], *given_too)
        ctx.mark_non_differentiable(results[4])
        ctx.set_materialize_grads(False)  # PyTorch's threads would fill zeros, and wait
        return tuple(results)

    @staticmethod
    @once
    def backward(
        ctx: Any, saved: tuple[Tensor, ...], *d: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        """Gradients by the Gaussians and the cameras."""
        call, device = ctx.call, ctx.call.device
        sizes, begun = call.extents.shape[:3], call.take_begun(d[:4])
        by_screen = [None if one is None or begun else host_of(one) for one in d[:4]]
        if by_screen[0] is not None:
            by_screen[0] = unpacked_rows(call.rows, by_screen[0], sizes)
        sums: dict[str, list[npt.NDArray[Any]]] = {}
        d_viewmats = np.zeros(call.given.viewmats.shape, np.float32)
        for at, (batch, number) in enumerate(product(*map(range, sizes[:2]))):
            if begun is None:
                d_mean2d, d_whitening, d_depth, d_opacity = (
                    device.zeros((sizes[2], *width))
                    if one is None
                    else device.share(one[batch, number])
                    for one, width in zip(by_screen, ((2,), (3,), (), ()), strict=True)
                )
                none = device.empty((sizes[2], 0))
                given = ChannelGradients(d_mean2d, d_whitening, d_opacity, none, d_depth, None)
                made = call.backward(batch, at, given)
            else:
                made = begun
            if made.d_camera is not None:
                rows = device.download(made.d_camera).sum(axis=2, dtype=np.float64)
                d_viewmats[batch, number, :3] = rows
            arrays = {n: one for n, one in vars(made).items() if one is not None}
            arrays.pop("d_camera", None)
            hosts = device.hand_over_all(list(arrays.values()))
            for name, host in zip(arrays, hosts, strict=True):
                if number:
                    sums[name][batch] += host
                else:
                    sums.setdefault(name, []).append(host)
        total = {name: stacked(arrays) for name, arrays in sums.items()}
        d_scales, d_covars = total.get("d_shape"), None
        if ctx.by_covariance and d_scales is not None:
            d_covars = np.zeros((*d_scales.shape[:2], 3, 3), np.float32)
            d_covars[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]] = d_scales
            d_scales = None
        d_given = (
            total.get("d_mean"),
            total.get("d_rotation"),
            d_scales,
            d_covars,
            total.get("d_opacity"),
            d_viewmats if call.want_camera else None,
        )
        like = zip(d_given, saved[2:], strict=True)
        return None, None, *(None if one is None else tensor_like(one, own) for one, own in like)


class Blend(torch.autograd.Function):  # type: ignore[misc]  # torch is Any
    """Centres and all else of the screen to images (..., C, H, W, X) and alphas (..., C, H, W, 1).

    The projection of the same call has begun to draw them, if there is one.

    centres: (B, C, N, 2), or those of the projection of the same call; colors: (..., N, D), as
    ``call.colors`` (B, 1 or C, N, D) counts them.
    """

    @staticmethod
    def forward(
        ctx: Any,
        call: BlendCall,
        centres: Tensor,
        whitening: Tensor,
        depths: Tensor,
        opacities: Tensor,
        extents: Tensor,
        colors: Tensor,
        backgrounds: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Blend; returns images and alphas."""
        device = call.device
        if call.seen is None:
            arrays = [host_of(one) for one in (centres, whitening, depths, extents, opacities)]
            none = device.empty((whitening.shape[2], 0))
            for batch, number in product(*map(range, whitening.shape[:2])):
                own = (device.share(one[batch, number]) for one in arrays)
                mean2d, factor, depth, extent, opacity = own
                call.draw(batch, number, Projected(mean2d, factor, depth, extent, none, opacity))
        width, height = call.size
        sizes = whitening.shape[0], whitening.shape[1], height
        made = [one.picture for one in call.drawn]
        names = {"image": backgrounds.shape[-1], "transmittance": None, "alpha": None}
        gather = gather_later(device, made, names, (*sizes, width))
        # the tensors own the memory that the device has
        ctx.save_for_backward(centres, whitening, depths, opacities, extents, colors, backgrounds)
        ctx.set_materialize_grads(False)
        shape = *call.pictures, height, width
        image, left, alphas = gather().values()
        ctx.call, ctx.left = call, left
        image = image.reshape(*shape, backgrounds.shape[-1])
        return torch.from_numpy(image), torch.from_numpy(alphas.reshape(*shape, 1))

    @staticmethod
    @once
    def backward(
        ctx: Any, saved: tuple[Tensor, ...], *d: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        """Gradients by all that lies on the screen, colors and backgrounds."""
        call, device = ctx.call, ctx.call.device
        before, whitening, _, _, _, colors, backgrounds = saved
        # in NumPy: threads of PyTorch would take those of the device
        shape = ctx.left.shape
        d_image = None if d[0] is None else host_of(d[0]).reshape(*shape, backgrounds.shape[-1])
        d_left = None if d[1] is None else np.negative(host_of(d[1])).reshape(shape)
        found: list[ChannelGradients] = []
        shared: list[DeviceArray | None] = []
        for at, (batch, number) in enumerate(product(*map(range, whitening.shape[:2]))):
            drawn = call.drawn[at]
            by_left = None if d_left is None else device.share(d_left[batch, number])
            by_image = (
                device.zeros(drawn.picture.image.shape)
                if d_image is None
                else device.share(d_image[batch, number])
            )
            shared += by_image, by_left  # alive until the downloads
            found.append(channel_picture.backward(device, drawn, by_image, by_left, call.absgrad))
        sizes, rows = whitening.shape[:3], call.seen.rows if call.seen else None
        names = {"d_mean2d": 2, "d_whitening": 3, "d_opacity": None, "d_color": colors.shape[-1]}
        names |= {"d_depth": None} if call.with_depth else {}
        names |= {"d_absolute": 2} if call.absgrad else {}
        gather = gather_later(device, found, names, sizes)
        begun = None
        if call.seen and len(found) == 1 and ctx.needs_input_grad[1]:
            begun = call.seen.backward(0, 0, found[0])  # while the host makes tensors
        made = gather()
        centres = call.centres() if call.centres is not None else None
        if call.absgrad and centres is not None:
            absolute = packed_rows(rows, made["d_absolute"])
            if absolute.size != centres.numel():  # packed rows, which all pictures share
                absolute = absolute.sum(axis=(0, 1))
            centres.absgrad = torch.from_numpy(absolute.reshape(centres.shape))
        d_colors = made["d_color"]
        if call.colors.shape[1] != sizes[1]:
            d_colors = d_colors.sum(axis=1)
        d_backgrounds = None
        if ctx.needs_input_grad[7] and d_image is not None:
            both = torch.from_numpy(d_image), torch.from_numpy(ctx.left)
            d_backgrounds = torch.einsum("bchwx,bchw->bcx", *both)  # NumPy takes four times as long
        d_centres = tensor_like(packed_rows(rows, made["d_mean2d"]), before)
        others = made["d_whitening"], made.get("d_depth"), made["d_opacity"]
        by_screen = d_centres, *(None if one is None else torch.from_numpy(one) for one in others)
        if begun is not None:
            call.seen.expect(begun, list(by_screen))
        return None, *by_screen, None, tensor_like(d_colors, colors), d_backgrounds


class Harmonics(torch.autograd.Function):  # type: ignore[misc]  # torch is Any
    """Sums of harmonics (M, 3) in directions (M, 3), which need not be unit vectors."""

    @staticmethod
    def forward(ctx: Any, degree: int, dirs: Tensor, coeffs: Tensor) -> Tensor:
        """Sum the harmonics."""
        device = default_device()
        mean, sh = device.share(host_of(dirs)), device.share(host_of(coeffs))
        color = harmonics.forward(device, mean, sh, device.zeros((26,)), degree, bare=True)
        result = torch.from_numpy(device.hand_over(color))
        ctx.degree = degree
        ctx.save_for_backward(dirs, coeffs, result)
        return result

    @staticmethod
    @once
    def backward(ctx: Any, saved: tuple[Tensor, ...], *d: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients by directions and coefficients."""
        device = default_device()
        tensors = (*saved, d[0])
        dirs, coeffs, color, d_color = (device.share(host_of(one)) for one in tensors)
        camera = device.zeros((26,))
        d_sh, d_dirs = harmonics.backward(
            device, dirs, coeffs, camera, ctx.degree, color, d_color, bare=True
        )
        d_host = [torch.from_numpy(device.hand_over(one)) for one in (d_dirs, d_sh)]
        return None, *d_host
