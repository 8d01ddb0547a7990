"""The numbers that a scene may hold; every reader of a stored scene checks them."""

from __future__ import annotations

import math
from collections.abc import Iterator

from clgs.scene.anchors import QuantizationScales
from clgs.scene.scene import RenderSettings, SceneTransform

MIN_Q = 2.0**-64
"""Of Q and other scales; the greatest is its inverse."""


def check_ranges(
    scales: QuantizationScales, transform: SceneTransform, settings: RenderSettings
) -> None:
    """Raise ValueError, naming the field, if a number makes no sense."""
    for name, value, valid in _rules(scales, transform, settings):
        if not (math.isfinite(value) and valid):
            raise ValueError(f"{name} is {value!r}")


def _rules(
    scales: QuantizationScales, transform: SceneTransform, settings: RenderSettings
) -> Iterator[tuple[str, float, bool]]:
    """(field, value, whether it is in range) of every number."""
    for name, value in vars(scales).items():
        yield f"Q of {name}", value, _is_scale(value)
    yield "transform scale", transform.scale, _is_scale(transform.scale)
    for value in transform.centre:
        yield "transform centre", value, True
    for value in settings.background:
        yield "background", value, 0 <= value <= 1
    yield "near", settings.near, _is_scale(settings.near)
    yield "alpha_cut", settings.alpha_cut, 0 < settings.alpha_cut < 1
    yield "alpha_max", settings.alpha_max, settings.alpha_cut < settings.alpha_max <= 1
    stop = settings.transmittance_stop
    yield "transmittance_stop", stop, 0 <= stop < 1
    yield "blur", settings.blur, 0 <= settings.blur <= 2.0**64


def _is_scale(value: float) -> bool:
    """Whether products and quotients with any int32 stay finite and normal in float32."""
    return MIN_Q <= value <= 1 / MIN_Q
