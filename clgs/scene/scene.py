"""A scene: anchors and MLPs, or ordinary Gaussians, and the settings that rendering depends on."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from clgs import constants
from clgs.scene.anchors import AnchorSet, QuantizationScales, QuantizedAnchors, dequantize
from clgs.scene.gaussians import HostGaussians
from clgs.scene.mlps import Mlps


@dataclass(frozen=True)
class SceneTransform:
    """From the data's world to scene units: scene = (world - centre) * scale, in float64."""

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 1.0

    def to_scene(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """World points (N, 3) float64 to scene units."""
        return np.asarray((points - np.array(self.centre)) * self.scale)

    def to_world(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Scene points (N, 3) float64 to the data's world units."""
        return np.asarray(points / self.scale + np.array(self.centre))


@dataclass(frozen=True)
class RenderSettings:
    """What a render depends on besides anchors, MLPs and camera; stored in the file header.

    background: RGB in [0, 1]; near: scene units; the others as in ``clgs.constants``.
    """

    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near: float = constants.NEAR_PLANE
    alpha_cut: float = constants.ALPHA_CUT
    alpha_max: float = constants.ALPHA_MAX
    transmittance_stop: float = constants.TRANSMITTANCE_STOP
    blur: float = constants.BLUR


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
