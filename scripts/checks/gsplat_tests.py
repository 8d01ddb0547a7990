"""Run gsplat's own tests on the CPU, with ``clgs.torch`` in place of its CUDA functions.

    python scripts/checks/gsplat_tests.py CHECKOUT_OF_GSPLAT [ARGUMENTS OF PYTEST]

CHECKOUT_OF_GSPLAT: the repository at the version that is installed, for its tests and their data.
gsplat's PyTorch code of blending calls a CUDA function and nerfacc's, of which the CPU forms are
here. Where a test asks for covariances, it gets gsplat's PyTorch code.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
import types
from pathlib import Path
from typing import Any

import pytest
import torch
from gsplat import rendering
from gsplat.cuda import _torch_impl as impl
from gsplat.cuda import _wrapper
from torch import Tensor

import clgs.torch as ours
import clgs.torch.strategies  # puts CPU functions in gsplat's strategies  # noqa: F401

FILES = ("test_basic.py", "test_rasterization.py", "test_strategy.py")
FUNCTIONS = (
    "spherical_harmonics",
    "fully_fused_projection",
    "isect_tiles",
    "isect_offset_encode",
    "rasterize_to_pixels",
)
CHUNK = 256


@torch.no_grad()  # type: ignore[untyped-decorator]
def rasterize_to_indices_in_range(
    range_start: int,
    range_end: int,
    transmittances: Tensor,
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    image_width: int,
    image_height: int,
    tile_size: int,
    isect_offsets: Tensor,
    flatten_ids: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Gaussian, pixel and image of all that is blended, sorted by image, pixel and depth."""
    count, (rows, columns) = means2d.shape[-2], isect_offsets.shape[-2:]
    centre, conic, opacity = means2d.reshape(-1, 2), conics.reshape(-1, 3), opacities.reshape(-1)
    left = transmittances.reshape(-1, image_height, image_width)
    ends = torch.cat([isect_offsets.flatten(), torch.tensor([len(flatten_ids)])]).tolist()
    block = tile_size * tile_size
    found: list[Tensor] = []
    for tile, (first, end) in enumerate(itertools.pairwise(ends)):
        image, place = divmod(tile, rows * columns)
        top, side = (one * tile_size for one in divmod(place, columns))
        y, x = torch.meshgrid(
            torch.arange(top, min(top + tile_size, image_height)),
            torch.arange(side, min(side + tile_size, image_width)),
            indexing="ij",
        )
        y, x = y.flatten(), x.flatten()
        t = left[image, y, x].clone()
        for start in range(first + range_start * block, min(end, first + range_end * block), CHUNK):
            row = flatten_ids[start : min(start + CHUNK, end)].long()
            dx, dy = ((centre[row, k, None] - (one + 0.5)) for k, one in enumerate((x, y)))
            a, b, c = conic[row, :, None].unbind(1)
            sigma = 0.5 * (a * dx**2 + c * dy**2) + b * dx * dy
            alpha = (opacity[row, None] * torch.exp(-sigma)).clamp(max=0.999)
            alpha = torch.where((sigma >= 0) & (alpha >= 1 / 255), alpha, 0.0)
            after = t * torch.cumprod(1 - alpha, dim=0)
            entry, pixel = ((alpha > 0) & (after > 1e-4)).nonzero(as_tuple=True)
            where = (image * image_height + y[pixel]) * image_width + x[pixel]
            found.append(torch.stack([row[entry], where]))
            t = torch.where(after[-1] > 1e-4, after[-1], 0.0)
            if not t.any():
                break
    pairs = torch.cat(found, dim=1) if found else torch.zeros(2, 0, dtype=torch.long)
    gaussian, where = pairs[:, torch.argsort(pairs[1], stable=True)]
    pixels = image_width * image_height
    return gaussian % count, where % pixels, where // pixels


def render_weight_from_alpha(
    alphas: Tensor, ray_indices: Tensor, n_rays: int
) -> tuple[Tensor, Tensor]:
    """nerfacc's: alpha times the transmittance before it, of pairs sorted by ray."""
    logs = torch.log1p(-alphas.double())
    before = logs.cumsum(0) - logs
    starts = torch.searchsorted(ray_indices, torch.arange(n_rays)).clamp(max=len(alphas) - 1)
    left = torch.exp(before - before[starts][ray_indices]).float()
    return alphas * left, left


def accumulate_along_rays(
    weights: Tensor, values: Tensor | None, ray_indices: Tensor, n_rays: int
) -> Tensor:
    """nerfacc's: sums of weighted values by ray."""
    rows = weights[:, None] if values is None else weights[:, None] * values
    return torch.zeros(n_rays, rows.shape[1]).index_add(0, ray_indices, rows)


def replace() -> None:
    """Put these functions, and those of clgs, where gsplat's tests and code look for theirs."""
    for name in FUNCTIONS:
        for module in (_wrapper, rendering):
            setattr(module, name, getattr(ours, name))
    _wrapper.quat_scale_to_covar_preci = impl._quat_scale_to_covar_preci
    _wrapper.rasterize_to_indices_in_range = rasterize_to_indices_in_range
    rendering.rasterization = ours.rasterization
    nerfacc: Any = types.ModuleType("nerfacc")
    nerfacc.accumulate_along_rays = accumulate_along_rays
    nerfacc.render_weight_from_alpha = render_weight_from_alpha
    sys.modules["nerfacc"] = nerfacc


def main(checkout: Path, arguments: list[str]) -> int:
    """Run the tests, on the CPU; returns pytest's exit status."""
    replace()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "tests").mkdir()
        (root / "assets").symlink_to((checkout / "assets").resolve())
        for name in FILES:
            text = (checkout / "tests" / name).read_text()
            text = text.replace("not torch.cuda.is_available()", "False").replace(
                '"cuda:0"', '"cpu"'
            )
            (root / "tests" / name).write_text(text)
        return pytest.main([str(root / "tests"), "-q", "-p", "no:cacheprovider", *arguments])


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
