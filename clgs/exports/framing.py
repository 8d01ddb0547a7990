"""Where to look and from where: the middle of a scene, its up, and the ring that cameras go on.

With a data set, from its cameras: the point nearest to all optical axes, and a ring through the
cameras' places. Without one, from what the scene is made of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from clgs.scene.camera import Camera, optical_axes
from clgs.scene.scene import QuantizedScene, SplatScene

Vector = npt.NDArray[np.float64]

DEFAULT_FOV = 50.0
"""Vertical angle of view without a data set, degrees."""

ELEVATION = 20.0
"""How far a ring without a data set is above the middle, degrees."""

REACH = 4.0
"""Largest distance of the cameras of most data sets from their mean, scene units: a ring without a
data set stays within it, where the scene has been seen."""

HELD = 0.9
"""Share of a scene that such a ring has in view."""

OPEN_ARC = np.radians(120.0)
"""If cameras leave a gap this wide on their ring, an orbit goes to and fro between its ends."""

PARALLEL = 0.02
"""Optical axes whose matrix has a smaller eigenvalue do not meet in a point."""

OUTWARD = 0.5
"""Length of the mean direction below which cameras do not look the same way."""


@dataclass(frozen=True)
class Framing:
    """What a path goes around, scene units.

    centre, up (unit), east (unit, at right angles to up): (3,) float64; ring: its radius; height:
    of the ring above the centre; arc: (first, last) angles from east towards up x east that the
    ring may be used at, radians; fov: vertical angle of view, degrees; size: (width, height) in
    pixels.
    """

    centre: Vector
    up: Vector
    east: Vector
    ring: float
    height: float
    arc: tuple[float, float]
    fov: float
    size: tuple[int, int]

    @property
    def closed(self) -> bool:
        """Whether the whole ring may be used."""
        return self.arc[1] - self.arc[0] > 2 * np.pi - 1e-6

    def place(self, angle: float) -> Vector:
        """The point (3,) of the ring at ``angle``."""
        north = np.cross(self.up, self.east)
        flat = np.cos(angle) * self.east + np.sin(angle) * north
        return np.asarray(self.centre + self.ring * flat + self.height * self.up)


def frame_scene(
    scene: QuantizedScene | SplatScene, size: tuple[int, int], up: Vector | None = None
) -> Framing:
    """The framing of a scene by its anchors or Gaussians; ``up`` (3,) unit is guessed if None.

    The middle is their weighted median. Small ones weigh more, as they show detail. The ring has
    most of them in view and stays near where cameras usually are.
    """
    position, weight = _places(scene)
    if not len(position):
        position, weight = np.zeros((1, 3)), np.ones(1)
    centre = np.array([_quantile(position[:, axis], weight, 0.5) for axis in range(3)])
    distance = np.linalg.norm(position - centre, axis=1)
    held = _quantile(distance, weight, HELD) or 1.0
    narrow = np.radians(DEFAULT_FOV) * min(1.0, size[0] / size[1])
    far = held / np.sin(narrow / 2)
    if isinstance(scene, QuantizedScene) and not scene.transform.is_identity:
        far = min(far, REACH)
    chosen = guess_up(position - centre, scene) if up is None else up
    tilt = np.radians(ELEVATION)
    return Framing(
        *(centre, chosen, _east(chosen)),
        ring=float(far * np.cos(tilt)),
        height=float(far * np.sin(tilt)),
        arc=(0.0, 2 * np.pi),
        fov=DEFAULT_FOV,
        size=size,
    )


def guess_up(offset: Vector, scene: QuantizedScene | SplatScene) -> Vector:
    """Up (3,): z, or -y if the scene is flatter along it; of Blender scenes always z.

    Those are the axes that data sets have: z of transforms.json, -y of COLMAP.
    """
    z, minus_y = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
    if isinstance(scene, QuantizedScene) and scene.transform.is_identity:
        return z
    spread = np.percentile(np.abs(offset), 75, axis=0)
    return z if spread[2] <= spread[1] else minus_y


def frame_cameras(cameras: Sequence[Camera], fallback: Framing) -> Framing:
    """The framing of a data set by its cameras, at least one.

    ``fallback`` is the framing of the scene; it serves where the cameras give no answer.
    """
    centres = np.array([camera.centre for camera in cameras])
    forward = np.array([camera.rotation[2] for camera in cameras])
    up = common_up(cameras)
    centre = _meeting_point(centres, forward)
    if centre is None:
        depth = np.median((fallback.centre - centres) @ _unit(forward.mean(axis=0)))
        distance = depth if depth > 0 else fallback.ring
        centre = centres.mean(axis=0) + distance * _unit(forward.mean(axis=0))
    offset = centres - centre
    height = offset @ up
    flat = offset - height[:, None] * up
    east = _east(up)
    angle = np.arctan2(flat @ np.cross(up, east), flat @ east)
    first = cameras[0]
    middle = sorted(fov_y(camera) for camera in cameras)[len(cameras) // 2]
    return replace(
        fallback,
        centre=centre,
        up=up,
        east=east,
        ring=float(np.median(np.linalg.norm(flat, axis=1))) or fallback.ring,
        height=float(np.median(height)),
        arc=_arc(angle),
        fov=middle,
        size=(first.width, first.height),
    )


def look_outward(cameras: Sequence[Camera]) -> bool:
    """Whether cameras stand in a place and look around, so that no orbit shows what they saw."""
    centres = np.array([camera.centre for camera in cameras])
    forward = np.array([camera.rotation[2] for camera in cameras])
    apart = bool(np.linalg.norm(forward.mean(axis=0)) < OUTWARD)
    return apart and _meeting_point(centres, forward) is None


def fov_y(camera: Camera) -> float:
    """Vertical angle of view, degrees."""
    return float(np.degrees(2 * np.arctan(camera.height / (2 * camera.fy))))


def common_up(cameras: Sequence[Camera]) -> Vector:
    """The up (3,) that cameras share.

    At right angles to their x axes if these tell, which is right for cameras that look down, too;
    else the mean of their ups.
    """
    right = np.array([camera.rotation[0] for camera in cameras])
    mean = _unit(-np.array([camera.rotation[1] for camera in cameras]).mean(axis=0))
    values, vectors = np.linalg.eigh(right.T @ right / len(right))
    if values[1] < 0.05:
        return mean
    least = vectors[:, 0]
    return np.asarray(least * np.sign(least @ mean) if abs(least @ mean) > 0.5 else mean)


def _meeting_point(centres: Vector, forward: Vector) -> Vector | None:
    """The point (3,) nearest to all optical axes; None if they do not meet before the cameras."""
    matrix, right = optical_axes(centres, forward)
    if np.linalg.eigvalsh(matrix)[0] < PARALLEL:
        return None
    point = np.linalg.solve(matrix, right)
    ahead = np.sum((point - centres) * forward, axis=1) > 0
    return np.asarray(point) if ahead.mean() > 0.5 else None


def _arc(angle: Vector) -> tuple[float, float]:
    """The angles that are covered: all, or what the largest gap leaves if that is wide."""
    ordered = np.sort(angle)
    gaps = np.diff(np.append(ordered, ordered[0] + 2 * np.pi))
    widest = int(np.argmax(gaps))
    if gaps[widest] < OPEN_ARC:
        return 0.0, 2 * np.pi
    first = float(ordered[(widest + 1) % len(ordered)])
    return first, first + 2 * np.pi - float(gaps[widest])


def _places(scene: QuantizedScene | SplatScene) -> tuple[Vector, Vector]:
    """Positions (N, 3) in scene units, and how much each counts (N,)."""
    if isinstance(scene, SplatScene):
        gaussians = scene.gaussians
        log_size = gaussians.log_scale.astype(np.float64).mean(axis=1)
        shown = 1 / (1 + np.exp(-gaussians.opacity.astype(np.float64)))
        return gaussians.mean.astype(np.float64), shown * _small(log_size)
    anchors, scales = scene.anchors, scene.scales
    log_size = anchors.scaling[:, 3:].mean(axis=1) / scales.scaling
    return anchors.position / np.float64(scales.position), _small(log_size)


def _small(log_size: Vector) -> Vector:
    """Weights (N,) that fall with the size, from twice the median on."""
    if not len(log_size):
        return log_size
    ratio = np.exp(np.clip(log_size - np.median(log_size), -30, 30))
    return np.asarray(1 / (1 + ratio))


def _quantile(values: Vector, weight: Vector, share: float) -> float:
    """The value below which ``share`` of the weight lies."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order[min(np.searchsorted(total, share * total[-1]), len(values) - 1)]])


def _east(up: Vector) -> Vector:
    """A unit vector at right angles to ``up``: the axis least along it, straightened."""
    axis = np.eye(3)[int(np.argmin(np.abs(up)))]
    return _unit(axis - (axis @ up) * up)


def _unit(vector: Vector) -> Vector:
    length = float(np.linalg.norm(vector))
    return np.asarray(vector / length if length > 1e-12 else np.array([0.0, 0.0, 1.0]))
