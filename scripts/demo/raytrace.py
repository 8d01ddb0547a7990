"""A small ray tracer for static diffuse scenes; it shares no code with the rasteriser.

World: right-handed, z up, metres. Colours are linear light until ``develop`` makes 8-bit sRGB.
Every surface is a map from (u, v) to a point and a normal, triangulated for embree and painted
with a picture. Light that comes from everywhere is baked once a surface; the sun's share is
traced for every sample. No highlights: a point looks the same from all sides, as photogrammetry
assumes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]
Place = Callable[[npt.NDArray[Any], npt.NDArray[Any]], tuple[npt.NDArray[Any], npt.NDArray[Any]]]

SAMPLES = 3
"""Samples a pixel along each axis; each of the SAMPLES^2 looks at another spot of the sun."""

LIFT = 1e-3
"""Metres by which a shadow ray starts off the surface: above float32 noise, below any detail."""

BAKE_CELLS, BAKE_RAYS = 16, 64
"""Light from everywhere is sampled at BAKE_CELLS^2 points a surface with BAKE_RAYS rays each."""

GAMMA = 2.2


@dataclass(frozen=True)
class Surface:
    """A textured piece of surface.

    place: (u, v), each (P,), to points (P, 3) and unit normals (P, 3); uv (P, 2) of the vertices;
    faces (F, 3); picture (h, w, 3) float32 linear albedo, row 0 at v = 0.
    """

    place: Place
    uv: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int64]
    picture: Floats


@dataclass(frozen=True)
class Light:
    """towards_sun (3,) unit; sun, sky, ground: linear RGB (3,); sun_radius: of its disc, rad."""

    towards_sun: npt.NDArray[np.float64]
    sun: Floats
    sky: Floats
    ground: Floats
    sun_radius: float


@dataclass(frozen=True)
class View:
    """A pinhole camera: x_cam = rotation @ x + translation; x right, y down, z forward.

    The principal point is the centre of the picture; pixel centres are at +0.5.
    """

    rotation: npt.NDArray[np.float64]
    translation: npt.NDArray[np.float64]
    focal: float
    width: int
    height: int

    @classmethod
    def looking(
        cls,
        place: npt.NDArray[np.float64],
        target: npt.NDArray[np.float64],
        focal: float,
        width: int,
        height: int,
    ) -> View:
        """The upright view from ``place`` (3,) to ``target`` (3,)."""
        forward = (target - place) / np.linalg.norm(target - place)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        return cls(rotation, -rotation @ place, focal, width, height)

    @property
    def centre(self) -> npt.NDArray[np.float64]:
        """Where the camera is, (3,)."""
        return -self.rotation.T @ self.translation

    def rays(self, shift: tuple[float, float]) -> Floats:
        """Unit directions (H * W, 3) through the points ``shift`` in [0, 1]^2 of every pixel."""
        x = (np.arange(self.width) + shift[0] - self.width / 2) / self.focal
        y = (np.arange(self.height) + shift[1] - self.height / 2) / self.focal
        right, down, forward = self.rotation.astype(np.float32)
        across = np.outer(x, right).astype(np.float32) + forward
        world = across + np.outer(y, down).astype(np.float32)[:, None]
        return unit(world.reshape(-1, 3))

    def project(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Pixel coordinates (P, 2) of points (P, 3)."""
        local = points @ self.rotation.T + self.translation
        centre = np.array([self.width, self.height]) / 2
        return local[:, :2] / local[:, 2:] * self.focal + centre


@dataclass(frozen=True)
class Hits:
    """First hits of R rays: face (R,) or -1; distance (R,); normal (R, 3) unit; uv (R, 2).

    Rows without a hit hold values of face 0.
    """

    face: npt.NDArray[np.int32]
    distance: Floats
    normal: Floats
    uv: Floats


class RayScene:
    """Surfaces ready for tracing."""

    def __init__(self, surfaces: Sequence[Surface], light: Light) -> None:
        self.light = light
        self._build_mesh(surfaces)
        sizes = [surface.picture.shape[:2] for surface in surfaces]
        self._width = np.array([w for _, w in sizes])
        self._height = np.array([h for h, _ in sizes])
        self._first = np.cumsum([0, *(h * w for h, w in sizes)])[:-1]
        self._mean = np.array([s.picture.mean((0, 1)) for s in surfaces], np.float32)
        baked = [resize(self._bake(s), s.picture.shape[:2]) * s.picture for s in surfaces]
        texels = [
            np.concatenate([s.picture, lit], -1) for s, lit in zip(surfaces, baked, strict=True)
        ]
        self._texels = np.concatenate([t.reshape(-1, 6) for t in texels]).astype(np.float32)

    def _build_mesh(self, surfaces: Sequence[Surface]) -> None:
        """Embree's tree, and for every face its corner's normal and uv and their edge vectors."""
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        corners, points, indices, total = [], [], [], 0
        for surface in surfaces:
            point, normal = surface.place(surface.uv[:, 0], surface.uv[:, 1])
            corners.append(np.concatenate([normal, surface.uv], 1)[surface.faces])
            points.append(point)
            indices.append(surface.faces + total)
            total += len(point)
        corner = np.concatenate(corners).astype(np.float32)
        self._corner = corner[:, 0]
        self._edge_u, self._edge_v = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
        self._surface = np.repeat(np.arange(len(surfaces)), [len(s.faces) for s in surfaces])
        self._embree = rtcore_scene.EmbreeScene()
        TriangleMesh(
            scene=self._embree,
            vertices=np.concatenate(points).astype(np.float32),
            indices=np.concatenate(indices).astype(np.int32),
        )

    def trace(self, origin: Floats, direction: Floats) -> Hits:
        """First hits of rays from origin (R, 3) along unit direction (R, 3)."""
        found = self._embree.run(origin, direction, output=True)
        face = np.maximum(found["primID"], 0)
        value = self._corner[face]
        value += found["u"][:, None] * self._edge_u[face]
        value += found["v"][:, None] * self._edge_v[face]
        return Hits(found["primID"], found["tfar"], unit(value[:, :3]), value[:, 3:])

    def shade(self, origin: Floats, direction: Floats, towards_sun: Floats) -> Floats:
        """Linear colour (R, 3) that each ray sees, with a sun in direction ``towards_sun`` (3,)."""
        hits = self.trace(origin, direction)
        paint = self._lookup(self._surface[np.maximum(hits.face, 0)], hits.uv)
        color = paint[:, 3:]
        if self.light.sun.any():
            incidence = np.einsum("rc,c->r", hits.normal, towards_sun)
            lit = np.flatnonzero((hits.face >= 0) & (incidence > 0))
            way = hits.distance[lit, None] * direction[lit]
            start = origin[lit] + way + LIFT * hits.normal[lit]
            sunward = np.broadcast_to(towards_sun, start.shape).copy()
            lit = lit[self._embree.run(start, sunward, query="OCCLUDED") < 0]
            color[lit] += paint[lit, :3] * (incidence[lit, None] * self.light.sun)
        color[hits.face < 0] = self.light.sky
        return color

    def _lookup(self, surface: npt.NDArray[np.int64], uv: Floats) -> Floats:
        """Bilinear texels (R, 6): albedo, and colour under the light from everywhere."""
        width, height = self._width[surface], self._height[surface]
        x = np.clip(uv[:, 0] * width - 0.5, 0, width - 1.001)
        y = np.clip(uv[:, 1] * height - 0.5, 0, height - 1.001)
        column, row = x.astype(np.int64), y.astype(np.int64)
        right, down = (
            (x - column).astype(np.float32)[:, None],
            (y - row).astype(np.float32)[:, None],
        )
        index = self._first[surface] + row * width + column
        upper, lower = self._texels[index], self._texels[index + width]
        upper += right * (self._texels[index + 1] - upper)
        lower += right * (self._texels[index + width + 1] - lower)
        upper += down * (lower - upper)
        return upper

    def _bake(self, surface: Surface) -> Floats:
        """Light from sky and surroundings, (BAKE_CELLS, BAKE_CELLS, 3), as a factor of albedo.

        Rays that leave see the sky or the ground by their height, rays that hit something see
        its mean colour in half light: one bounce, roughly, which is what makes corners soft.
        """
        cell = (np.arange(BAKE_CELLS) + 0.5) / BAKE_CELLS
        u, v = (axis.ravel() for axis in np.meshgrid(cell, cell))
        point, normal = surface.place(u, v)
        directions = hemisphere(normal, BAKE_RAYS).astype(np.float32)
        start = np.repeat((point + LIFT * normal).astype(np.float32), BAKE_RAYS, axis=0)
        face = self._embree.run(start, directions)
        height = 0.5 + 0.5 * directions[:, 2:]
        seen = height * self.light.sky + (1 - height) * self.light.ground
        bounce = 0.5 * (self.light.sky + self.light.sun * 0.5)
        hit = face >= 0
        seen[hit] = self._mean[self._surface[face[hit]]] * bounce
        return seen.reshape(BAKE_CELLS, BAKE_CELLS, BAKE_RAYS, 3).mean(2)

    def render(self, view: View) -> npt.NDArray[np.uint8]:
        """The photo (H, W, 3), SAMPLES^2 samples a pixel."""
        total = np.zeros((view.height * view.width, 3), np.float32)
        origin = np.broadcast_to(view.centre.astype(np.float32), total.shape).copy()
        for sample, sun in enumerate(self._sun_spots()):
            row, column = divmod(sample, SAMPLES)
            shift = ((column + 0.5) / SAMPLES, (row + 0.5) / SAMPLES)
            total += self.shade(origin, view.rays(shift), sun)
        return develop(total / SAMPLES**2).reshape(view.height, view.width, 3)

    def _sun_spots(self) -> Floats:
        """SAMPLES^2 unit directions over the sun's disc, (SAMPLES^2, 3), in a sunflower pattern."""
        turn = np.arange(SAMPLES**2)
        radius = self.light.sun_radius * np.sqrt((turn + 0.5) / SAMPLES**2)
        angle = turn * np.pi * (3 - np.sqrt(5))
        across, along = tangents(self.light.towards_sun[None])
        spot = self.light.towards_sun + radius[:, None] * (
            np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * along
        )
        return (spot / np.linalg.norm(spot, axis=1, keepdims=True)).astype(np.float32)


def develop(color: Floats) -> npt.NDArray[np.uint8]:
    """Linear colour to 8-bit sRGB (gamma 2.2)."""
    return np.rint(255 * np.clip(color, 0, 1) ** (1 / GAMMA)).astype(np.uint8)


def unit(vectors: Floats) -> Floats:
    """Vectors (R, 3) divided by their lengths."""
    return vectors / np.sqrt(np.einsum("rc,rc->r", vectors, vectors))[:, None]


def tangents(normal: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Two unit vectors (P, 3) each that make a right-handed frame with unit normal (P, 3)."""
    steep = np.abs(normal[:, 2:]) > 0.9
    other = np.where(steep, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    across = np.cross(other, normal)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return across, np.cross(normal, across)


def hemisphere(normal: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.float64]:
    """The same ``count`` cosine-weighted directions about each normal (P, 3): (P * count, 3)."""
    turn = np.arange(count)
    radius = np.sqrt((turn + 0.5) / count)
    angle = turn * np.pi * (3 - np.sqrt(5))
    local = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], 1)
    across, along = tangents(normal)
    frame = np.stack([across, along, normal], 1)
    return np.einsum("kc,pcd->pkd", local, frame).reshape(-1, 3)


def resize(picture: Floats, shape: tuple[int, ...]) -> Floats:
    """Bicubic enlargement of (h, w, 3) to shape (H, W)."""
    from PIL import Image

    channels = [
        np.asarray(Image.fromarray(channel).resize((shape[1], shape[0]), Image.Resampling.BICUBIC))
        for channel in np.moveaxis(picture, -1, 0)
    ]
    return np.stack(channels, -1)
