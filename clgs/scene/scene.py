"""A scene: anchors and MLPs, or ordinary Gaussians, and the numbers that rendering depends on."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from clgs import constants
from clgs.scene.anchors import AnchorSet, QuantizationScales, QuantizedAnchors, dequantize
from clgs.scene.camera import UNKNOWN, PhotoRange
from clgs.scene.gaussians import HostGaussians
from clgs.scene.mlps import Mlps
from clgs.scene.world import LOCAL, NOWHERE, Place, is_world

MIN_Q = 2.0**-64
"""The least Q and other scale; the greatest is its inverse."""


@dataclass(frozen=True)
class SceneTransform:
    """Turns the data's world into scene units: scene = (world - centre) * scale, in float64.

    frame: what the world is, as of clgs.scene.world; place: where its origin is, if that is EARTH.
    """

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 1.0
    frame: float = LOCAL
    place: Place = NOWHERE

    @property
    def is_identity(self) -> bool:
        """Whether scene units are the world's."""
        return self.centre == (0.0, 0.0, 0.0) and self.scale == 1.0

    def to_scene(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """World points (N, 3) float64 to scene units."""
        return np.asarray((points - np.array(self.centre)) * self.scale)

    def to_world(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Scene points (N, 3) float64 to the data's world units."""
        return np.asarray(points / self.scale + np.array(self.centre))


IDENTITY = SceneTransform()
"""Scene units are the world's."""


@dataclass(frozen=True)
class RenderSettings:
    """What a render depends on, except anchors, MLPs and camera; stored in the file header.

    background: RGB in [0, 1]; near: scene units; photos: those that the scene was learned from; the
    others as in ``clgs.constants``.
    """

    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near: float = constants.NEAR_PLANE
    alpha_cut: float = constants.ALPHA_CUT
    alpha_max: float = constants.ALPHA_MAX
    transmittance_stop: float = constants.TRANSMITTANCE_STOP
    blur: float = constants.BLUR
    photos: PhotoRange = UNKNOWN

    def __post_init__(self) -> None:
        """Numbers of a file are taken for a PhotoRange."""
        object.__setattr__(self, "photos", PhotoRange(*self.photos))


@dataclass
class Scene:
    """A renderable scene in float32."""

    anchors: AnchorSet
    mlps: Mlps
    settings: RenderSettings = field(default_factory=RenderSettings)
    transform: SceneTransform = field(default_factory=SceneTransform)

    def __post_init__(self) -> None:
        self.anchors.check(np.float32)

    def __repr__(self) -> str:
        """One line: the fields would be pages."""
        return f"<Scene: {len(self.anchors):,} anchors>"


@dataclass
class QuantizedScene:
    """A scene as the bitstream holds it: integers, float32 MLP weights, settings.

    ``dequantize`` gives the very same float32 scene before encoding and after decoding.
    """

    anchors: QuantizedAnchors
    mlps: Mlps
    scales: QuantizationScales = field(default_factory=QuantizationScales)
    settings: RenderSettings = field(default_factory=RenderSettings)
    transform: SceneTransform = field(default_factory=SceneTransform)

    def __post_init__(self) -> None:
        self.anchors.check(np.int32)

    def __repr__(self) -> str:
        """One line: the fields would be pages."""
        return f"<QuantizedScene: {len(self.anchors):,} anchors>"

    def world_position(self) -> npt.NDArray[np.float64]:
        """Positions of the anchors (A, 3) in the units of the input data."""
        return self.transform.to_world(self.anchors.position / np.float64(self.scales.position))

    def dequantize(self) -> Scene:
        """The float32 scene that is rendered."""
        anchors = dequantize(self.anchors, self.scales)
        return Scene(anchors, self.mlps, self.settings, self.transform)


@dataclass
class SplatScene:
    """A renderable scene of ordinary Gaussians; by default in the units of its data set."""

    gaussians: HostGaussians
    settings: RenderSettings = field(default_factory=RenderSettings)
    transform: SceneTransform = field(default_factory=SceneTransform)

    def __post_init__(self) -> None:
        self.gaussians.check(np.float32)

    def __repr__(self) -> str:
        """One line: the fields would be pages."""
        return f"<SplatScene: {len(self.gaussians):,} Gaussians>"


def drawable(scene: QuantizedScene | SplatScene) -> Scene | SplatScene:
    """What is rendered of a scene from a file."""
    return scene.dequantize() if isinstance(scene, QuantizedScene) else scene


def check_ranges(
    scales: QuantizationScales, transform: SceneTransform, settings: RenderSettings
) -> None:
    """Raise ValueError, naming the field, if a number makes no sense."""
    stop = settings.transmittance_stop
    rules = [
        *((f"Q of {name}", value, _is_scale(value)) for name, value in vars(scales).items()),
        ("transform scale", transform.scale, _is_scale(transform.scale)),
        *(("transform centre", value, True) for value in transform.centre),
        ("transform frame", transform.frame, is_world(transform.frame, transform.place)),
        *(("background", value, 0 <= value <= 1) for value in settings.background),
        ("near", settings.near, _is_scale(settings.near)),
        ("alpha_cut", settings.alpha_cut, 0 < settings.alpha_cut < 1),
        ("alpha_max", settings.alpha_max, settings.alpha_cut < settings.alpha_max <= 1),
        ("transmittance_stop", stop, 0 <= stop < 1),
        ("blur", settings.blur, 0 <= settings.blur <= 2.0**64),
    ]
    if problem := settings.photos.problem():
        raise ValueError(f"photos: {problem}")
    for name, value, valid in rules:
        if not (math.isfinite(value) and valid):
            raise ValueError(f"{name} is {value!r}")


def _is_scale(value: float) -> bool:
    """Whether products and quotients with any int32 stay finite and normal in float32."""
    return MIN_Q <= value <= 1 / MIN_Q
