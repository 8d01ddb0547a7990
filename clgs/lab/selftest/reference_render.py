"""Whole renders and their backward pass in float64, and the distance of a result from them.

One render is decision-matched: the order of Gaussians, the contributors of every pixel and the
saturation of alpha come from the device. Only rounding is left to differ.

The other one has no truncation: every accuracy setting is an approximation of it. No alpha cut and
no transmittance stop: every Gaussian in front of the camera reaches every pixel, but for pairs with
an alpha below RESOLUTION, which float64 could not tell from none. What belongs to the method stays:
the anchors that a view may see, positive opacities, alpha of at most ALPHA_MAX and the blur.
References make all decisions, none is taken from a device.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.cli.tell import tell
from clgs.constants import ALPHA_CUT, ALPHA_MAX, TILE_SIZE
from clgs.files import atomic_path, cache_folder
from clgs.lab.kernels import blend_decisions
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.reference import blend, cull, loss, mlp, neural, project, tiles
from clgs.render.frame import Frame
from clgs.scene.scene import Scene

Array = npt.NDArray[np.float64]
Gradients = dict[str, Array]
Packed = npt.NDArray[np.float32]

Timed = tuple[str, str, float, float, Callable[[], object]]
"""Stage, quantity, error, limit, and the work that is timed."""


@dataclass(frozen=True)
class ReferenceFrame:
    """Float64 results of every stage of one render."""

    scene: dict[str, Array]
    camera: Array
    background: Array
    activations: mlp.Activations
    gaussians: neural.NeuralGaussians
    projected: project.Projected
    lists: tiles.TileLists
    decisions: blend.Decisions
    image: Array


def wide(scene: Scene) -> dict[str, Array]:
    """The scene's parameters in float64."""
    arrays = {**dict(scene.anchors.items()), "weights": scene.mlps.flat}
    return {name: array.astype(np.float64) for name, array in arrays.items()}


def render_reference(
    device: Device, scene: Scene, frame: Frame, d_image: DeviceArray
) -> ReferenceFrame:
    """Repeat a render of the device in float64.

    Args:
        device: what rendered ``frame``.
        scene: what was rendered.
        frame: the render.
        d_image: (3, H, W) float32; the backward kernel's decisions must equal the forward one's.

    Raises:
        ValueError: forward and backward kernels decided differently.
    """
    host = wide(scene)
    visible = device.download(frame.activations.visible)
    names = ("gaussian", "row", "tile_range", "row_range")
    found = {name: device.download(getattr(frame.tiles, name)) for name in names}
    lists = tiles.TileLists(**found)
    decisions, back = blend_decisions(device, frame.blended, d_image)
    if not np.array_equal(decisions.contributed, back.contributed):
        raise ValueError("forward and backward kernels disagree on contributors")
    camera, background = (
        device.download(one) for one in (frame.view.camera, frame.view.background)
    )
    return _render(
        host,
        visible,
        camera.astype(np.float64),
        background.astype(np.float64),
        frame.view.size,
        lambda opacity, projected: (lists, decisions),
    )


def _render(
    host: dict[str, Array],
    visible: npt.NDArray[Any],
    camera: Array,
    background: Array,
    size: tuple[int, int],
    decide: Callable[[Array, project.Projected], tuple[tiles.TileLists, blend.Decisions]],
    alpha_cut: float = ALPHA_CUT,
) -> ReferenceFrame:
    """Every stage; ``decide`` has the lists and decisions for opacities and what is projected."""
    activations = mlp.forward(host["feature"], host["position"], visible, host["weights"], camera)
    gaussians = neural.forward(
        activations.output, visible, host["position"], host["offset"], host["scaling"]
    )
    shape = gaussians.mean, gaussians.scale, gaussians.rotation, gaussians.opacity
    projected = project.forward(*shape, camera, alpha_cut=alpha_cut)
    lists, decisions = decide(gaussians.opacity, projected)
    image = blend.forward(
        projected, gaussians.color, gaussians.opacity, lists, background, size, decisions
    ).image
    return ReferenceFrame(
        host, camera, background, activations, gaussians, projected, lists, decisions, image
    )


def backward_reference(frame: ReferenceFrame, d_image: Array, volume_weight: float) -> Gradients:
    """d_offset, d_feature, d_scaling, d_weights for given d_image (3, H, W) float64."""
    shape = (frame.gaussians.mean, frame.gaussians.scale, frame.gaussians.rotation)
    splats = blend.backward(
        frame.projected,
        frame.gaussians.color,
        frame.gaussians.opacity,
        frame.lists,
        frame.background,
        frame.decisions,
        d_image,
    )
    d_mean, d_scale, d_rotation = project.backward(
        shape, frame.camera, frame.projected, splats.d_mean2d, splats.d_whitening
    )
    d_scale = d_scale + loss.volume(frame.gaussians.scale, volume_weight)[1]
    d_gaussians = neural.GaussianGradients(
        d_mean, d_scale, d_rotation, splats.d_color, splats.d_opacity
    )
    d_output, d_offset, d_scaling = neural.backward(
        frame.gaussians,
        frame.activations.output,
        frame.activations.visible,
        frame.scene["offset"],
        frame.scene["scaling"],
        d_gaussians,
    )
    d_weights, d_feature = mlp.backward(
        frame.activations, len(frame.scene["feature"]), frame.scene["weights"], d_output
    )
    return {
        "d_offset": d_offset,
        "d_feature": d_feature,
        "d_scaling": d_scaling,
        "d_weights": d_weights,
    }


@dataclass(frozen=True)
class Check:
    """One quantity of one stage: its error, the limit, and the stage's median milliseconds.

    The stage passes if ``error <= limit``; NaN does not.
    """

    stage: str
    quantity: str
    error: float
    limit: float
    milliseconds: float

    @property
    def passed(self) -> bool:
        """Whether the error is a number within the limit."""
        return self.error <= self.limit

    @property
    def share(self) -> float:
        """The error in units of its limit; not a number if the error is not."""
        return self.error / self.limit if self.limit else self.error * np.inf if self.error else 0.0


def failed(stage: str, error: Exception) -> Check:
    """A check that an exception ended; its quantity says what happened."""
    said = " ".join(str(error).split())[:200]
    return Check(stage, f"{type(error).__name__}: {said}", float("nan"), 0.0, 0.0)


def relative_errors(
    device: Device, found: object, wanted: object, names: Iterable[str]
) -> dict[str, float]:
    """:func:`relative_l2` of each named array of two records, the first of them on ``device``."""
    return {
        name: relative_l2(device.download(getattr(found, name)), getattr(wanted, name))
        for name in names
    }


def largest(actual: npt.NDArray[Any], expected: npt.NDArray[Any]) -> float:
    """Largest absolute difference; infinite for different shapes, NaN spreads."""
    if actual.shape != expected.shape:
        return float("inf")
    return float(np.max(np.abs(actual.astype(np.float64) - expected), initial=0.0))


def relative_l2(actual: npt.NDArray[Any], expected: npt.NDArray[Any]) -> float:
    """||actual - expected|| / ||expected||; infinite for different shapes, NaN spreads."""
    if actual.shape != expected.shape:
        return float("inf")
    norm = float(np.linalg.norm(np.asarray(expected, np.float64)))
    error = float(np.linalg.norm(actual.astype(np.float64) - expected))
    return error / norm if norm else error


RESOLUTION = 1e-18
VERSION = b"untruncated 1"
"""Part of the cache's keys; to be changed with the numbers."""


def render_untruncated(
    scene: Scene, camera: Packed, size: tuple[int, int], background: Packed
) -> ReferenceFrame:
    """Render one view; the frame serves :func:`reference_render.backward_reference`.

    Args:
        scene: float32 parameters.
        camera: (26,) float32 from ``Camera.pack``.
        size: width and height, pixels.
        background: (3,) float32.
    """
    host, wide_camera, behind = wide(scene), camera.astype(float), background.astype(float)
    visible = cull.forward(host["position"], host["scaling"], wide_camera)

    def decide(
        opacity: Array, projected: project.Projected
    ) -> tuple[tiles.TileLists, blend.Decisions]:
        lists = box_lists(projected, *size)
        # where alpha would exceed ALPHA_MAX: only Gaussians that are more opaque than that
        saturated = np.zeros((len(lists.gaussian), TILE_SIZE**2), bool)
        entries = np.flatnonzero(opacity[lists.gaussian] > ALPHA_MAX)
        gaussian = lists.gaussian[entries]
        tile = np.searchsorted(lists.tile_range, entries, side="right") - 1
        columns = -(-size[0] // TILE_SIZE)
        y, x = (axis.ravel() + 0.5 for axis in np.mgrid[:TILE_SIZE, :TILE_SIZE])
        corner = np.stack([tile % columns, tile // columns], axis=1) * TILE_SIZE
        dx, dy = (
            corner[:, axis, None] + centre - projected.mean2d[gaussian, axis, None]
            for axis, centre in enumerate((x, y))
        )
        r1, slope, r2 = projected.whitening[gaussian].T[:, :, None]
        power = 0.5 * ((dx * r1) ** 2 + ((dy - slope * dx) * r2) ** 2)
        saturated[entries] = opacity[gaussian, None] * np.exp(-power) > ALPHA_MAX
        return lists, blend.Decisions(np.ones_like(saturated), saturated)

    return _render(host, visible, wide_camera, behind, size, decide, RESOLUTION)


def box_lists(projected: project.Projected, width: int, height: int) -> tiles.TileLists:
    """Every Gaussian in every tile that its box overlaps, by tile, then depth."""
    grid = np.array([-(-width // TILE_SIZE), -(-height // TILE_SIZE)])
    low, high = projected.mean2d - projected.extent, projected.mean2d + projected.extent
    first = np.floor(low / TILE_SIZE).clip(0, grid).astype(np.int64)
    span = (np.floor(high / TILE_SIZE) + 1).clip(first, grid).astype(np.int64) - first
    counts = np.where(projected.extent[:, 0] > 0, span[:, 0] * span[:, 1], 0)
    row_range = np.concatenate([[0], np.cumsum(counts)])
    gaussian = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(row_range[-1]) - row_range[gaussian]
    column = first[gaussian, 0] + within % span[gaussian, 0]
    tile = (first[gaussian, 1] + within // span[gaussian, 0]) * grid[0] + column
    order = np.lexsort((gaussian, projected.depth[gaussian], tile))
    return tiles.TileLists(
        gaussian=gaussian[order],
        row=order,
        tile_range=np.searchsorted(tile[order], np.arange(grid[0] * grid[1] + 1)),
        row_range=row_range,
    )


def cached_reference(
    scene: Scene,
    camera: Packed,
    size: tuple[int, int],
    background: Packed,
    d_image: npt.NDArray[np.float32],
) -> dict[str, Array]:
    """The image (3, H, W) and the gradients of sum(d_image * image) by name, float64.

    They are kept in the user's cache folder, by a hash of all that they depend on.
    """
    arrays: list[npt.NDArray[Any]] = [*wide(scene).values(), camera, background, d_image]
    digest = hashlib.sha256(VERSION)
    for array in [*arrays, np.array(size)]:
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    path = cache_folder() / f"{digest.hexdigest()}.npz"
    if path.exists():
        with np.load(path) as stored:
            return {name: np.asarray(stored[name], np.float64) for name in stored.files}
    tell(f"clgs: float64 reference without truncation: computed once, then kept in {path.parent}")
    frame = render_untruncated(scene, camera, size, background)
    result = {"image": frame.image, **backward_reference(frame, d_image.astype(np.float64), 0.0)}
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        np.savez(temporary, **result)  # type: ignore[arg-type]
    return result
