"""The options of ``clgs.rasterization``: checked, named in errors, refused if not offered."""

from __future__ import annotations

from typing import Any

import numpy as np

from clgs.arguments import check_type
from clgs.opencl.device import Device
from clgs.ops.general.views import Lens
from clgs.options import RenderOptions

UNDISTORT = "undistort the photos before"
GLOBAL = "cameras are global; use None"
DRAW_AGAIN = "draw them as colors of another call"
LARGEST = float(np.finfo(np.float32).max)
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


def checked_lens(given: dict[str, Any]) -> Lens:
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
    return Lens(
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
    check_type("options", given["options"], RenderOptions, "see clgs.RenderOptions")
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
