"""nerfstudio's method ``clgs-splatfacto``: its splatfacto, drawn here, on a machine without CUDA.

``ns-train clgs-splatfacto --machine.device-type cpu`` finds ``METHOD`` by its entry point. It is
made when it is asked for: nerfstudio's table of methods, which it comes from, asks while it loads.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

import gsplat
import torch
from nerfstudio.models import splatfacto
from nerfstudio.plugins.types import MethodSpecification
from torch import Tensor

from clgs.torch import rasterization


class ClgsSplatfactoModel(splatfacto.SplatfactoModel):  # type: ignore[misc]  # it is Any
    """Splatfacto, which draws with :func:`clgs.torch.rasterization`."""

    def populate_modules(self) -> None:
        """Make the Gaussians, of points that stay on the CPU.

        Raises:
            ImportError: gsplat, whose strategy is used, is older than 1.5.
        """
        if [int(part) for part in gsplat.__version__.split(".")[:2]] < [1, 5]:
            raise ImportError(f"gsplat {gsplat.__version__} is too old: pip install gsplat==1.5.3")
        with _drawn_here():
            super().populate_modules()

    def get_outputs(self, camera: Any) -> Any:
        """Draw what ``camera`` sees."""
        with _drawn_here():
            return super().get_outputs(camera)


@dataclass
class ClgsSplatfactoModelConfig(splatfacto.SplatfactoModelConfig):  # type: ignore[misc]  # it is Any
    """Splatfacto's settings."""

    _target: type = field(default_factory=lambda: ClgsSplatfactoModel)


@contextmanager
def _drawn_here() -> Iterator[None]:
    """Give splatfacto this rasteriser, and leave tensors where they are: it moves some to a card.

    A function of its own is compiled in C++; it runs as Python.
    """
    theirs = splatfacto.rasterization, Tensor.cuda
    splatfacto.rasterization, Tensor.cuda = rasterization, lambda tensor: tensor
    try:
        with torch.compiler.set_stance("force_eager"):
            yield
    finally:
        splatfacto.rasterization, Tensor.cuda = theirs


def __getattr__(name: str) -> MethodSpecification:
    if name != "METHOD":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from nerfstudio.configs.method_configs import method_configs

    config = deepcopy(method_configs["splatfacto"])
    config.method_name = "clgs-splatfacto"
    config.pipeline.model = ClgsSplatfactoModelConfig()
    return MethodSpecification(config, "Splatfacto by clgs.torch, on any OpenCL device, no CUDA.")
