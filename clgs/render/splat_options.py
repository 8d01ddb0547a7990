"""The options of ``clgs.rasterization``: checked, named in errors, refused if not offered."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clgs.ops.general.views import Lens

UNDISTORT = "undistort the photos before"
GLOBAL = "cameras are global; use None"
DRAW_AGAIN = "draw them as colors of another call"

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
    "rays": (None, "cameras are pinhole or ortho; use None"),
    "lidar_coeffs": (None, "cameras are pinhole or ortho; use None"),
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
        if value is not default and (default is None or value != default):
            raise NotImplementedError(f"{name}: {value!r} is not offered; {instead}")
    check_tile_size(given["tile_size"])
    if given["camera_model"] not in ("pinhole", "ortho"):
        model = given["camera_model"]
        raise NotImplementedError(
            f"camera_model: {model!r} is not offered; {UNDISTORT}, or use 'ortho'"
        )
    if given["rasterize_mode"] not in ("classic", "antialiased"):
        mode = given["rasterize_mode"]
        raise ValueError(f"rasterize_mode: {mode!r} is not 'classic' or 'antialiased'")
    if given["options"].accuracy.inclusive_stop:
        raise ValueError("options: an inclusive stop is not offered; use 'parity'")
    if not 0 < given["alpha_max"] < 1:
        raise ValueError(f"alpha_max: {given['alpha_max']} is not between 0 and 1")
    check_size(given["width"], given["height"])
    names = ("near_plane", "far_plane", "radius_clip", "eps2d")
    check_numbers(**{name: given[name] for name in names})
    return Lens(
        parallel=given["camera_model"] == "ortho",
        compensated=given["rasterize_mode"] == "antialiased",
        blur=given["eps2d"],
        near=given["near_plane"],
        far=given["far_plane"],
        smallest_radius=given["radius_clip"],
    )


def check_tile_size(tile_size: int | None) -> None:
    """NotImplementedError unless it is 16, or None, gsplat's default from 1.6 on."""
    if tile_size not in (None, 16):
        raise NotImplementedError(
            f"tile_size: {tile_size!r} is not offered; no picture depends on it; use 16"
        )


def check_numbers(**numbers: float) -> None:
    """TypeError or ValueError unless each is a finite number of at least 0."""
    for name, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise TypeError(f"{name}: is {type(value).__name__}; give a number")
        if not 0 <= value < math.inf:
            raise ValueError(f"{name}: {value} is not a finite number of at least 0")


def check_size(width: int, height: int) -> None:
    """TypeError or ValueError unless both are whole numbers of 1 to 32767 pixels."""
    for name, value in (("width", width), ("height", height)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer):
            raise TypeError(f"{name}: is {type(value).__name__}; give a whole number of pixels")
        if not 1 <= value <= 32767:
            raise ValueError(f"{name}: {value} is not 1 to 32767 pixels")
