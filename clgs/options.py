"""Options of a render: its accuracy, and the work that it skips.

Accuracy changes the picture within stated limits. A skip leaves out only work that cannot change a
bit of the picture, so that it can be switched off to measure what it saves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

from clgs.arguments import check_range, check_type
from clgs.constants import ALPHA_CUT, TRANSMITTANCE_STOP
from clgs.errors import UsageError

BACKGROUNDS = {"black": (0.0, 0.0, 0.0), "white": (1.0, 1.0, 1.0)}
"""Colors of the fixed backgrounds."""

MAX_LAYERS = 64
"""The most layers of a file."""


@dataclass(frozen=True)
class Accuracy:
    """What a render truncates.

    alpha_cut: pairs of a pixel and a Gaussian with a smaller alpha contribute nothing;
    transmittance_stop: a pixel is finished at this transmittance; inclusive_stop: whether the
    Gaussian that crosses it is still blended; exp2_degree: degree of the polynomial of 2^x, 3 to 6;
    downscale: pictures are rendered at 1/downscale of their size and enlarged; min_extent: a
    Gaussian is left out if its box of visible alpha reaches fewer pixels from its centre, along
    both axes.
    """

    name: str = "parity"
    alpha_cut: float = ALPHA_CUT
    transmittance_stop: float = TRANSMITTANCE_STOP
    inclusive_stop: bool = False
    exp2_degree: int = 6
    downscale: int = 1
    min_extent: float = 0.0

    def defines(self) -> dict[str, int | float]:
        """Build options of the kernels that decide about alpha, by macro name."""
        return {
            "ALPHA_CUT": self.alpha_cut,
            "LOG2_ALPHA_CUT": math.log2(self.alpha_cut),
            "TRANSMITTANCE_STOP": self.transmittance_stop,
            "STOP_INCLUSIVE": int(self.inclusive_stop),
            "EXP2_DEGREE": self.exp2_degree,
        }


PARITY = Accuracy()
"""The truncation of 3DGS and of the paper."""

PRESETS = {
    preset.name: preset
    for preset in (
        Accuracy("exact", alpha_cut=1 / 16384, transmittance_stop=1e-6, inclusive_stop=True),
        PARITY,
        Accuracy("fast", transmittance_stop=1e-3, inclusive_stop=True, exp2_degree=4),
        Accuracy(
            "preview", transmittance_stop=1 / 255, inclusive_stop=True, exp2_degree=3, downscale=2
        ),
    )
}
"""What ``--accuracy`` takes."""


@dataclass(frozen=True)
class Skips:
    """Work that cannot change the picture or its gradients and is therefore left out.

    anchors: anchors outside of the frustum; opacity_first: color and covariance of anchors without
    a positive opacity; slots: outputs of slots without a positive opacity; exact_tiles: tiles that
    the box of a Gaussian touches but its ellipse does not; units: pixels outside of its extent;
    finished: pixels and tiles that no further Gaussian can change; contributors: entries behind the
    last contributor in the backward pass; empty_tiles: tiles that show only the background.
    """

    anchors: bool = True
    opacity_first: bool = True
    slots: bool = True
    exact_tiles: bool = True
    units: bool = True
    finished: bool = True
    contributors: bool = True
    empty_tiles: bool = True

    def defines(self, *names: str) -> dict[str, int | float]:
        """Build options SKIP_<NAME> (0 or 1) of the skips that a program knows."""
        known = {one.name for one in fields(self)}
        if unknown := set(names) - known:
            raise ValueError(f"no skips of the name {sorted(unknown)}")
        return {f"SKIP_{name.upper()}": int(getattr(self, name)) for name in names}


@dataclass(frozen=True)
class RenderOptions:
    """Accuracy and skips of a render, and two limits.

    smallest_anchor: anchors that are fewer pixels wide on the screen are left out, which changes
    the picture; max_memory: bytes that tile lists, records and rows of gradients may take at a
    time, or None for no limit. It makes a render draw in groups of tiles, which changes nothing but
    the time.
    """

    accuracy: Accuracy = PARITY
    skips: Skips = field(default_factory=Skips)
    smallest_anchor: float = 0.0
    max_memory: int | None = None


DEFAULT = RenderOptions()


def render_options(
    accuracy: str, max_memory: int | None = None, smallest_anchor: float = 0.0
) -> RenderOptions:
    """Options of one of PRESETS: "exact", "parity", "fast" or "preview".

    ``max_memory`` is in MiB, None or 0 for no limit; ``smallest_anchor`` in pixels, 0 for all.

    Raises:
        UsageError: there is no such preset, or a number is out of range.
        TypeError: ``accuracy`` is no text.
    """
    check_type("accuracy", accuracy, str, "such as 'parity'")
    if accuracy not in PRESETS:
        raise UsageError(f"accuracy: {accuracy!r} is not one of {', '.join(PRESETS)}")
    if max_memory is not None:
        check_range("max_memory", max_memory, 0)
    if not 0 <= smallest_anchor < math.inf:
        raise UsageError(f"smallest_anchor: {smallest_anchor} is not a finite number of at least 0")
    budget = max_memory * 2**20 if max_memory else None
    return RenderOptions(PRESETS[accuracy], smallest_anchor=smallest_anchor, max_memory=budget)
