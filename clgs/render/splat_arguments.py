"""What ``clgs.rasterization`` is given: checked, named in errors, and as flat batches.

Its options, too: those that are not offered are refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.arguments import check_type
from clgs.constants import UNIT_OPACITY
from clgs.opencl.device import Device
from clgs.ops.general.views import CameraModel
from clgs.options import RenderOptions

UNDISTORT = "undistort the photos before"
GLOBAL = "cameras are global; use None"
DRAW_AGAIN = "draw them as colors of another call"
SMALLEST, LARGEST = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
MODELS = "pinhole", "ortho", "fisheye"
FLAGS = ("packed", "absgrad", "segmented")

REFUSED: dict[str, tuple[Any, str]] = {
    "sparse_grad": (False, "gradients are dense; use False"),
    "distributed": (False, "one process draws all; use False"),
    "with_ut": (False, UNDISTORT),
    "with_eval3d": (False, "use False"),
    "radial_coeffs": (None, UNDISTORT),
    "tangential_coeffs": (None, UNDISTORT),
    "thin_prism_coeffs": (None, UNDISTORT),
    "ftheta_coeffs": (None, UNDISTORT),
    "rolling_shutter": (None, GLOBAL),
    "viewmats_rs": (None, GLOBAL),
}
"""Arguments of gsplat 1.5.3 that are not offered: their defaults, and what to do instead."""

REFUSED_LATER: dict[str, tuple[Any, str]] = {
    "return_normals": (False, DRAW_AGAIN),
    "global_z_order": (True, "Gaussians are sorted by depth; use True"),
    "rays": (None, f"cameras are {', '.join(MODELS)}; use None"),
    "lidar_coeffs": (None, f"cameras are {', '.join(MODELS)}; use None"),
    "external_distortion_coeffs": (None, UNDISTORT),
    "ut_params": (None, "use None"),
    "extra_signals": (None, DRAW_AGAIN),
    "extra_signals_sh_degree": (None, DRAW_AGAIN),
    "renderer_config": (None, "use None"),
}
"""The same of those that only gsplat 1.6 has."""


def checked_lens(given: dict[str, Any]) -> CameraModel:
    """The camera that arguments of ``rasterization`` describe, by their names.

    Raises:
        NotImplementedError: an option asks for what is not offered; names it.
        TypeError, ValueError: an option cannot be used; names it.
    """
    if unknown := given["later"].keys() - REFUSED_LATER:
        raise TypeError(f"rasterization() has no argument {sorted(unknown)[0]!r}")
    values = {**given, **given["later"]}
    if getattr(given["rolling_shutter"], "name", None) == "GLOBAL":
        values["rolling_shutter"] = None
    for name, (default, instead) in (REFUSED | REFUSED_LATER).items():
        value = values.get(name, default)
        if value is not default and (default is None or not _is_flag(value, default)):
            raise NotImplementedError(f"{name}: {value!r} is not offered; {instead}")
    _check_settings(given)
    if given["camera_model"] not in MODELS:
        model = given["camera_model"]
        raise NotImplementedError(
            f"camera_model: {model!r} is not offered; {UNDISTORT}, or use one of {MODELS}"
        )
    if given["rasterize_mode"] not in ("classic", "antialiased"):
        mode = given["rasterize_mode"]
        raise ValueError(f"rasterize_mode: {mode!r} is not 'classic' or 'antialiased'")
    return CameraModel(
        model=given["camera_model"],
        compensated=given["rasterize_mode"] == "antialiased",
        blur=given["eps2d"],
        near=given["near_plane"],
        far=given["far_plane"],
        smallest_radius=given["radius_clip"],
    )


def _check_settings(given: dict[str, Any]) -> None:
    """Check what needs no other argument; nothing is ignored, even if no result depends on it."""
    check_tile_size(given["tile_size"])
    for name in FLAGS:
        if not any(_is_flag(given[name], flag) for flag in (False, True)):
            raise TypeError(f"{name}: is {given[name]!r}; give True or False")
    chunk = given["channel_chunk"]
    if not isinstance(chunk, int | np.integer) or chunk < 1:
        raise ValueError(f"channel_chunk: {chunk!r} is not a whole number of at least 1")
    check_type("options", given["options"], RenderOptions, "see clgs.render_options")
    if given["options"].accuracy.inclusive_stop:
        raise ValueError("options: an inclusive stop is not offered; use 'parity'")
    if given["device"] is not None:
        check_type("device", given["device"], Device, "see clgs.Device")
    check_size(given["width"], given["height"])
    names = ("near_plane", "far_plane", "radius_clip", "eps2d", "alpha_max")
    check_numbers(**{name: given[name] for name in names})
    if not 0 < given["alpha_max"] < 1:
        raise ValueError(f"alpha_max: {given['alpha_max']} is not between 0 and 1")


def _is_flag(value: Any, flag: bool) -> bool:
    return isinstance(value, bool | int | np.bool_) and value == flag


def check_tile_size(tile_size: int | None) -> None:
    """NotImplementedError unless it is 16, or None, gsplat's default from 1.6 on."""
    if tile_size is not None and not (isinstance(tile_size, int | np.integer) and tile_size == 16):
        raise NotImplementedError(
            f"tile_size: {tile_size!r} is not offered; no picture depends on it; use 16"
        )


def check_numbers(**numbers: float) -> None:
    """TypeError or ValueError unless each is a number of at least 0 that float32 can hold."""
    for name, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise TypeError(f"{name}: is {type(value).__name__}; give a number")
        if not 0 <= value <= LARGEST:
            raise ValueError(f"{name}: {value} is not a finite float32 of at least 0")


def check_size(width: int, height: int) -> None:
    """TypeError or ValueError unless both are whole numbers of 1 to 32767 pixels."""
    for name, value in (("width", width), ("height", height)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer):
            raise TypeError(f"{name}: is {type(value).__name__}; give a whole number of pixels")
        if not 1 <= value <= 32767:
            raise ValueError(f"{name}: {value} is not 1 to 32767 pixels")


Floats = npt.NDArray[np.float32]

RENDER_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")

ALONG_RAYS = ("d", "Ed", "RGB-d", "RGB-Ed")
"""Modes that only gsplat 1.6 has: distances along rays, for its Gaussians in the world."""


@dataclass(frozen=True)
class SplatArguments:
    """B batches of N Gaussians, C cameras each; arrays are contiguous.

    batch: the leading axes, whose product is B; means (B, N, 3); quats (B, N, 4) and scales
    (B, N, 3), or covars (B, N, 6), upper triangles; opacities (B, N); colors (B, 1 or C, N, D) or
    harmonics (B, 1 or C, N, K, 3), the 1 if all cameras share them; viewmats (B, C, 4, 4) and Ks
    (B, C, 3, 3) float64; backgrounds (B, C, channels): zeros if none are given, and of the depth;
    channels: of the colors.
    """

    batch: tuple[int, ...]
    means: Floats
    quats: Floats | None
    scales: Floats | None
    covars: Floats | None
    opacities: Floats
    colors: Floats
    viewmats: npt.NDArray[np.float64]
    Ks: npt.NDArray[np.float64]
    backgrounds: Floats
    shared_colors: bool
    channels: int

    def check_colors(self) -> None:
        """ValueError unless all are finite; names argument and shape."""
        colors = self.colors[:, 0] if self.shared_colors else self.colors
        _check_finite("colors", colors, self.batch)

    def check_values(self) -> None:
        """Check the numbers of the Gaussians, which takes longer than all else.

        Raises:
            ValueError: a number cannot be used; names argument and shape.
        """
        self.check_colors()
        _check_finite("means", self.means, self.batch)
        if self.scales is not None:
            _check_finite("scales", self.scales, self.batch)
        opacities, quats = self.opacities, self.quats
        if opacities.size and not (opacities.min() >= 0 and opacities.max() <= UNIT_OPACITY):
            _check_finite("opacities", opacities, self.batch)
            shape = *self.batch, *opacities.shape[1:]
            raise ValueError(f"opacities: {shape} has numbers outside of 0 to 1; logits: sigmoid")
        if quats is not None:
            _check_finite("quats", quats, self.batch)
            short = quats[np.abs(quats[..., 0]) < 1e-6]  # the others have a length
            if not (np.abs(short) >= SMALLEST).any(axis=1).all():
                shape = *self.batch, *quats.shape[1:]
                raise ValueError(f"quats: {shape} has a quaternion of length 0, no rotation")


def check_arguments(
    means: Any,
    quats: Any,
    scales: Any,
    opacities: Any,
    colors: Any,
    viewmats: Any,
    Ks: Any,  # noqa: N803  the field's name of intrinsics
    sh_degree: int | None,
    backgrounds: Any,
    render_mode: str,
    covars: Any,
) -> SplatArguments:
    """Check all arrays, those of the device as the host sees them, against each other.

    The numbers of the Gaussians are left to :meth:`SplatArguments.check_values`.

    Raises:
        NotImplementedError: ``render_mode`` is one that only gsplat 1.6 has.
        TypeError: an argument is no array, or of another dtype.
        ValueError: a shape does not fit, or a number cannot be used; names argument and shape.
    """
    _check_mode(render_mode, sh_degree)
    batch = _array("means", means).shape[:-2]
    if means.ndim < 2 or means.shape[-1] != 3:
        raise ValueError(f"means: shape is {means.shape}, expected (..., N, 3)")
    if _array("viewmats", viewmats).ndim < 3:
        raise ValueError(f"viewmats: shape is {viewmats.shape}, expected (..., C, 4, 4)")
    n, c = means.shape[-2], viewmats.shape[-3]
    means = _fit("means", means, batch, (n, 3))
    opacities = _fit("opacities", opacities, batch, (n,))
    if covars is None:
        quats = _fit("quats", quats, batch, (n, 4))
        scales = _fit("scales", scales, batch, (n, 3))
    else:
        quats = scales = None
        covars = _fit("covars", covars, batch, (n, 3, 3))
        _check_finite("covars", covars, batch)  # its lower triangle, too, which is not kept
        covars = np.ascontiguousarray(covars[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]])
    viewmats = _fit("viewmats", viewmats, batch, (c, 4, 4), np.float64)
    _check_finite("viewmats", viewmats, batch)
    Ks = _fit("Ks", Ks, batch, (c, 3, 3), np.float64)  # noqa: N806
    _check_finite("Ks", Ks, batch)
    _check_cameras(viewmats, Ks)
    colors, shared = _fit_colors(colors, batch, n, c, sh_degree)
    shown = 3 if sh_degree is not None else colors.shape[-1]
    if shown == 0:
        raise ValueError(f"colors: {colors.shape} has no channels")
    given = shown if "RGB" in render_mode else 0
    shade = np.zeros((math.prod(batch), c, given + (render_mode != "RGB")), np.float32)
    if backgrounds is not None:
        backgrounds = _fit("backgrounds", backgrounds, batch, (c, shown))
        _check_finite("backgrounds", backgrounds, batch)
        shade[..., :given] = backgrounds[..., :given]
    return SplatArguments(
        batch, means, quats, scales, covars, opacities, colors, viewmats, Ks, shade, shared, shown
    )  # fmt: skip


def _check_mode(render_mode: Any, sh_degree: Any) -> None:
    if not isinstance(render_mode, str):
        raise TypeError(f"render_mode: is {type(render_mode).__name__}; give a string")
    if render_mode in ALONG_RAYS:
        raise NotImplementedError(
            f"render_mode: {render_mode!r}, a distance along rays, is not offered; use 'ED'"
        )
    if render_mode not in RENDER_MODES:
        raise ValueError(f"render_mode: {render_mode!r} is not one of {', '.join(RENDER_MODES)}")
    whole = isinstance(sh_degree, int | np.integer) and not isinstance(sh_degree, bool)
    if sh_degree is not None and not (whole and 0 <= sh_degree <= 4):
        raise ValueError(f"sh_degree: {sh_degree!r} is not None or 0 to 4")


def _array(name: str, value: Any) -> npt.NDArray[Any]:
    if not isinstance(value, np.ndarray) or isinstance(value, np.ma.MaskedArray):
        raise TypeError(
            f"{name}: is {type(value).__name__}; give a NumPy array, or one of pyopencl"
        )
    return value


def _fit(
    name: str,
    value: Any,
    batch: tuple[int, ...],
    shape: tuple[int, ...],
    dtype: npt.DTypeLike = np.float32,
) -> npt.NDArray[Any]:
    """The array as (B, *shape), contiguous; small ones of any floats become ``dtype``."""
    array = _array(name, value)
    if array.shape != (*batch, *shape):
        raise ValueError(f"{name}: shape is {array.shape}, expected {(*batch, *shape)}")
    if array.dtype != np.float32 and (dtype == np.float32 or array.dtype.kind != "f"):
        raise TypeError(f"{name}: dtype is {array.dtype}, expected float32")
    return np.ascontiguousarray(array, dtype).reshape(math.prod(batch), *shape)


def _check_finite(name: str, array: npt.NDArray[Any], batch: tuple[int, ...]) -> None:
    if array.dtype != np.float32:  # on the device everything is
        with np.errstate(over="ignore"):
            array = array.astype(np.float32)
    # the sum of squares may overflow: then every number is asked
    if not (np.isfinite(np.vdot(array, array)) or np.isfinite(array).all()):
        shape = *batch, *array.shape[1:]
        raise ValueError(f"{name}: {shape} has numbers that are not finite")


def _fit_colors(
    colors: Any, batch: tuple[int, ...], n: int, c: int, sh_degree: int | None
) -> tuple[Floats, bool]:
    """Colors as (B, 1 or C, N, ...), and whether all cameras share them."""
    array = _array("colors", colors)
    rest = 1 if sh_degree is None else 2
    shared = array.ndim == len(batch) + 1 + rest
    if array.ndim not in (len(batch) + 1 + rest, len(batch) + 2 + rest):
        kind = "D" if sh_degree is None else "K, 3"
        remedy = "" if sh_degree is None else "; colors that are no harmonics: sh_degree=None"
        raise ValueError(
            f"colors: shape is {array.shape}, expected (..., N, {kind}) or (..., C, N, {kind})"
            + remedy
        )
    if sh_degree is None and not shared and c != n == array.shape[-3]:
        raise ValueError(f"colors: shape is {array.shape}; give sh_degree if they are harmonics")
    if sh_degree is None:
        tail: tuple[int, ...] = (array.shape[-1],)
    else:
        tail = (array.shape[-2], 3)
        if array.shape[-2] < (sh_degree + 1) ** 2:
            raise ValueError(
                f"colors: {array.shape} has fewer harmonics than the {(sh_degree + 1) ** 2} that "
                f"sh_degree {sh_degree} needs"
            )
    cameras = () if shared else (c,)
    fitted = _fit("colors", array, batch, (*cameras, n, *tail))
    return fitted[:, None] if shared else fitted, shared


def _check_cameras(viewmats: npt.NDArray[np.float64], intrinsics: npt.NDArray[np.float64]) -> None:
    for matrix in viewmats.reshape(-1, 4, 4):
        *rows, last = matrix.tolist()
        if last != [0, 0, 0, 1]:
            raise ValueError("viewmats: the last row of a matrix is not 0, 0, 0, 1")
        (a, b, c, _), (d, e, f, _), (g, h, i, _) = rows
        if not abs(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)) > 1e-12:
            raise ValueError("viewmats: a matrix has no inverse")
    for (fx, skew, _), (lean, fy, _), _ in intrinsics.reshape(-1, 3, 3).tolist():
        if not (fx > 0 and fy > 0):
            raise ValueError("Ks: a focal length is not above 0")
        if skew or lean:
            raise ValueError("Ks: a matrix has skew, which no camera here has")
