"""The constants of the method, in one place; kernels receive them as build options.

Sources: Voxel-GS (arXiv 2512.17528) and the Scaffold-GS / 3DGS rasteriser that it builds on.
"""

from __future__ import annotations

import math

K_OFFSETS = 10
"""Neural Gaussians an anchor (k in the paper)."""

FEATURE_DIM = 50
"""Channels of an anchor feature (m in the paper)."""

INPUT_DIM = FEATURE_DIM + 3
"""Inputs of every MLP: the feature and the unit viewing direction."""

HIDDEN_DIM = 50
"""Width of the hidden layer of every MLP."""

HEAD_DIMS = {"opacity": K_OFFSETS, "color": 3 * K_OFFSETS, "covariance": 7 * K_OFFSETS}
"""Outputs of the three MLPs, in the order in which their weights and outputs are packed."""

OUTPUT_DIM = 11 * K_OFFSETS
"""Outputs of the three MLPs together."""

TILE_SIZE = 16
"""Edge of a rasteriser tile, pixels."""

BLUR = 0.3
"""Low-pass term added to the diagonal of every projected covariance, square pixels."""

PIXEL_VARIANCE = 1.0 / 12.0
"""Variance along an axis of the mean over a pixel, square pixels."""

FRUSTUM_MARGIN = 0.15
"""The Jacobian clamps x/z and y/z this fraction of the image outside of it (1.3 tan(fov/2))."""

NEAR_PLANE = 0.2
"""Camera-space depth below which nothing is drawn, scene units."""

ALPHA_CUT = 1.0 / 255.0
"""Pixel-splat pairs with a smaller alpha contribute nothing."""

UNIT_OPACITY = 1.0 + 1e-6
"""Opacities up to this are 1: sigmoids and products of float32 may round up."""

ALPHA_MAX = 0.99
"""Alpha saturates here; the gradient is zero above."""

TRANSMITTANCE_STOP = 1e-4
"""A pixel stops before the splat that would bring its transmittance below this value."""

LOG_SCALE_LIMIT = 20.0
"""|log scale| is clamped to this before exponentiation; zero gradient outside."""

LEAST_CONTRIBUTION = 0.1
"""Share of a picture that a block must make up for the camera to belong to it."""

SSIM_WINDOW = 11
SSIM_SIGMA = 1.5
SSIM_C1 = 0.01**2
SSIM_C2 = 0.03**2


def defines() -> dict[str, int | float]:
    """Build options that every kernel receives, by macro name; those of accuracy: options.py."""
    return {
        "K_OFFSETS": K_OFFSETS,
        "FEATURE_DIM": FEATURE_DIM,
        "HIDDEN_DIM": HIDDEN_DIM,
        "TILE_SIZE": TILE_SIZE,
        "BLUR": BLUR,
        "PIXEL_VARIANCE": PIXEL_VARIANCE,
        "ALPHA_MAX": ALPHA_MAX,
        "UNIT_OPACITY": UNIT_OPACITY,
        "LOG2_ALPHA_MAX": math.log2(ALPHA_MAX),
        "LOG_SCALE_LIMIT": LOG_SCALE_LIMIT,
    }
