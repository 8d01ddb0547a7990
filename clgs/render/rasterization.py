"""``clgs.rasterization``: pictures of Gaussians that NumPy or pyopencl holds, and their gradients.

Arguments, defaults and results are those of ``gsplat.rasterization`` 1.5.3; docs/reference has a
table of what is the same, what differs and what is refused.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from threading import Lock

import numpy as np
import numpy.typing as npt

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.lent import lent_array
from clgs.ops.general import harmonics, views
from clgs.options import DEFAULT, RenderOptions
from clgs.render import channel_picture
from clgs.render.splat_arguments import Floats, check_arguments, checked_lens
from clgs.render.splat_meta import RasterizationMeta, meta_of
from clgs.render.splat_record import SMALLEST_ALPHA, Record, RecordedView

ALPHA_MAX = 0.999
"""Where alpha saturates, as in gsplat; training keeps ``clgs.constants.ALPHA_MAX``."""


_one_at_a_time = Lock()


def default_device() -> Device:
    """The device of calls that name none: the one that ``clgs devices`` lists first."""
    with _one_at_a_time:  # the first calls of several threads must not open several
        return _open_device()


@cache
def _open_device() -> Device:
    return Device()


def rasterization(  # noqa: PLR0913  gsplat's arguments
    means: Floats,
    quats: Floats | None,
    scales: Floats | None,
    opacities: Floats,
    colors: Floats,
    viewmats: npt.NDArray[np.floating],
    Ks: npt.NDArray[np.floating],  # noqa: N803  the field's name of intrinsics
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int | None = 16,
    backgrounds: Floats | None = None,
    render_mode: str = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: str = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: str = "pinhole",
    segmented: bool = False,
    covars: Floats | None = None,
    with_ut: bool = False,
    with_eval3d: bool = False,
    radial_coeffs: object = None,
    tangential_coeffs: object = None,
    thin_prism_coeffs: object = None,
    ftheta_coeffs: object = None,
    rolling_shutter: object = None,
    viewmats_rs: object = None,
    *,
    device: Device | None = None,
    alpha_max: float = ALPHA_MAX,
    options: RenderOptions = DEFAULT,
    **later: object,
) -> tuple[Floats, Floats, RasterizationMeta]:
    """Draw N Gaussians as C cameras see them; ``...`` are batches of both.

    Camera axes are OpenCV's: x right, y down, z forward; pixel centres lie at +0.5. Arrays are
    NumPy's, or ``pyopencl.array.Array`` made with ``device.queue``, which are read where they lie.
    They must not change before the last call of ``meta["record"].backward``: a CPU device reads
    NumPy's where they are, too.

    Args:
        means: (..., N, 3) float32, scene units.
        quats: (..., N, 4) float32, w x y z, of any length from 1e-18 to 1e18.
        scales: (..., N, 3) float32, scene units.
        opacities: (..., N) float32, 0 to 1.
        colors: (..., [C,] N, D) float32, or harmonics (..., [C,] N, K, 3) with ``sh_degree``.
        viewmats: (..., C, 4, 4) floats, world to camera.
        Ks: (..., C, 3, 3) floats, intrinsics in pixels, without skew.
        width: of the pictures, pixels.
        height: of the pictures, pixels.
        near_plane: smallest depth that is drawn, scene units.
        far_plane: largest depth that is drawn.
        radius_clip: Gaussians that reach no more pixels along both axes are left out.
        eps2d: blur added to both variances on the screen, square pixels.
        sh_degree: degree of the harmonics that are used, 0 to 4; None if colors are colors.
        packed: whether the arrays of ``meta`` list only what is drawn.
        tile_size: 16, or None.
        backgrounds: (..., C, D) float32.
        render_mode: "RGB", "D" (sum of weighted depths), "ED" (that by alpha), "RGB+D", "RGB+ED".
        sparse_grad: False.
        absgrad: whether the backward pass sums absolute gradients by centres, too.
        rasterize_mode: "classic", or "antialiased": opacities make up for the blur.
        channel_chunk: has no effect: channels are blended by 32 in any case.
        distributed: False.
        camera_model: "pinhole", "ortho" or "fisheye", which is equidistant.
        segmented: has no effect.
        covars: (..., N, 3, 3) float32 in place of quats and scales; upper triangles are read.
        with_ut: False.
        with_eval3d: False.
        radial_coeffs: None.
        tangential_coeffs: None.
        thin_prism_coeffs: None.
        ftheta_coeffs: None.
        rolling_shutter: None or global.
        viewmats_rs: None.
        device: where it is computed; default a device that is opened once.
        alpha_max: where alpha saturates.
        options: where pixels end, and a memory budget.
        later: arguments of gsplat 1.6 alone, with its defaults.

    Returns:
        colors (..., C, H, W, X) and alphas (..., C, H, W, 1), float32, and ``meta``, in which
        ``meta["record"]`` is the :class:`Record` with the gradients.

    Raises:
        NotImplementedError: an argument asks for what is not offered; names it.
        TypeError, ValueError: an argument cannot be used; names it and its shape.
        BudgetError: a row of tiles needs more than ``options.max_memory``.
    """
    lens = checked_lens(locals())
    on = device or default_device()
    arrays = {
        "means": means, "quats": quats, "scales": scales, "opacities": opacities,
        "colors": colors, "viewmats": viewmats, "Ks": Ks, "backgrounds": backgrounds,
        "covars": covars,
    }  # fmt: skip
    found = {name: lent_array(on, name, value) for name, value in arrays.items()}
    lent = {name: array for name, array in found.items() if array is not None}
    arrays |= {name: on.hand_over(array) for name, array in lent.items()}
    given = check_arguments(**arrays, sh_degree=sh_degree, render_mode=render_mode)
    given.check_values()
    record = Record(on, given, lens, sh_degree, render_mode, absgrad, (width, height), lent, [])
    for batch, number in product(*map(range, given.viewmats.shape[:2])):
        record.views.append(_draw(record, batch, number, alpha_max, options))
    shape = (*given.batch, given.viewmats.shape[1], height, width)
    image = _stacked([view.image for view in record.views], (*shape, given.backgrounds.shape[-1]))
    alpha = _stacked([view.alpha for view in record.views], (*shape, 1))
    drawn = [view.drawn for view in record.views]
    counts = given.viewmats.shape[1], given.means.shape[1]
    meta = meta_of(on, drawn, given.batch, *counts, record.size, packed)
    meta["record"] = record
    return image, alpha, meta


def _draw(
    record: Record,
    batch: int,
    number: int,
    alpha_max: float,
    options: RenderOptions,
) -> RecordedView:
    """Draw what camera ``number`` of a batch sees."""
    device, given, lens, size = record.device, record.given, record.lens, record.size
    with_depth, shows_colors = record.render_mode != "RGB", "RGB" in record.render_mode
    if number:
        splats = record.views[-1].splats
    else:
        shape = given.scales if given.covars is None else given.covars
        assert shape is not None
        splats = views.Splats(
            _on_device(record, "means", given.means[batch]),
            _on_device(record, "scales", shape[batch]),
            None if given.quats is None else _on_device(record, "quats", given.quats[batch]),
            _on_device(record, "opacities", given.opacities[batch]),
        )
    packed = views.pack_camera(
        given.viewmats[batch, number], given.Ks[batch, number], size, lens.near
    )
    camera, stored = device.upload(packed), None
    own = given.colors[batch, number % given.colors.shape[1]]
    if shows_colors and record.sh_degree is not None:
        stored = _on_device(record, "colors", own)
        with device.stage("harmonics forward"):
            color = harmonics.forward(device, splats.mean, stored, camera, record.sh_degree)
    else:
        color = _on_device(record, "colors", own) if shows_colors else device.empty((len(own), 0))
    with device.stage("views forward"):
        projected = views.forward(device, splats, camera, lens, color, options)
    background = device.share(given.backgrounds[batch, number])
    drawn = channel_picture.draw(
        device, projected, size, background, with_depth, alpha_max, options
    )
    image = device.download(drawn.picture.image)
    alpha = device.download(drawn.picture.alpha)[..., None]
    if "ED" in record.render_mode:
        image[..., -1:] /= np.maximum(alpha, SMALLEST_ALPHA)
    return RecordedView(splats, camera, stored, drawn, image, alpha)


def _on_device(record: Record, name: str, host: Floats) -> DeviceArray:
    """An argument where it lies, if that is the whole of a lent array; else the host's, shared."""
    lent = record.lent.get(name)
    if lent is not None and lent.size == host.size:
        return DeviceArray(lent.buffer, host.shape, lent.dtype)
    return record.device.share(host)


def _stacked(arrays: list[Floats], shape: tuple[int, ...]) -> Floats:
    """A copy of all as one array."""
    return np.array(arrays, np.float32).reshape(shape)
