"""gsplat's own strategies, and what takes the place of its CUDA functions on the CPU.

``MCMCStrategy`` calls two of them: covariances from quaternions and scales, for which gsplat has
PyTorch code, too, and the relocation, which is written here.

Source: 3DGS as Markov chain Monte Carlo (Kheradmand et al. 2024), equation 9.
"""

from __future__ import annotations

from typing import Any

import torch
from gsplat.cuda import _torch_impl
from gsplat.strategy import DefaultStrategy as DefaultStrategy
from gsplat.strategy import MCMCStrategy as MCMCStrategy
from gsplat.strategy import Strategy as Strategy
from gsplat.strategy import ops
from torch import Tensor


def compute_relocation(
    opacities: Tensor,
    scales: Tensor,
    ratios: Tensor,
    binoms: Tensor,
    min_opacity: float = 0.0,
) -> tuple[Tensor, Tensor]:
    """Opacities and scales with which n copies of a Gaussian look like it alone.

    The copies have opacity o' = 1 - (1 - o)^(1/n), and scales times o / s, with s the sum over j
    of 1 to n of C(n, j) (-1)^(j - 1) o'^j / sqrt(j).

    Args:
        opacities: (N,) float32.
        scales: (N, 3) float32.
        ratios: (N,) int, n; clamped to 1 .. n_max.
        binoms: (n_max, n_max), which tells n_max.
        min_opacity: copies have no less; gsplat 1.6 gives it, 1.5.3 clamps what is returned.

    Returns:
        Opacities (N,) and scales (N, 3) float32.
    """
    n_max = len(binoms)
    n = ratios.clamp(1, n_max).double()[:, None]
    old = opacities.double()[:, None]
    new = (-torch.expm1(torch.log1p(-old) / n)).clamp(min=min_opacity)
    j = torch.arange(1, n_max + 1, dtype=torch.float64)
    rest = n - j + 1  # C(n, j) = C(n, j - 1) (n - j + 1) / j, which is 0 from j = n + 1 on
    terms = torch.cumprod(rest.clamp(min=0) / j * -new, dim=1) / torch.sqrt(j)
    share = old / -terms.sum(dim=1, keepdim=True)
    return new[:, 0].to(opacities.dtype), (share * scales).to(scales.dtype)


def _on_cpu(name: str, own: Any) -> None:
    """Let gsplat's strategies call ``own`` for tensors on the CPU."""
    theirs = getattr(ops, name)

    def chosen(*tensors: Tensor, **others: Any) -> Any:
        first = next(one for one in (*tensors, *others.values()) if isinstance(one, Tensor))
        return (own if first.device.type == "cpu" else theirs)(*tensors, **others)

    setattr(ops, name, chosen)


_on_cpu("compute_relocation", compute_relocation)
_on_cpu("quat_scale_to_covar_preci", _torch_impl._quat_scale_to_covar_preci)
