"""A render without truncation in float64: what every accuracy setting is an approximation of.

No alpha cut and no transmittance stop: every Gaussian in front of the camera reaches every pixel,
but for pairs with an alpha below RESOLUTION, which float64 could not tell from none. What belongs
to the method stays: the anchors that a view may see, positive opacities, alpha of at most ALPHA_MAX
and the blur. References make all decisions, none is taken from a device.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.cli.tell import tell
from clgs.constants import ALPHA_MAX, TILE_SIZE
from clgs.files import atomic_path, cache_folder
from clgs.lab.selftest.reference_render import ReferenceFrame, backward_reference, wide
from clgs.reference import blend, cull, mlp, neural, project, tiles
from clgs.scene.scene import Scene

RESOLUTION = 1e-18
VERSION = b"untruncated 1"
"""Part of the cache's keys; to be changed with the numbers."""

Array = npt.NDArray[np.float64]
Packed = npt.NDArray[np.float32]


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
    host, wide_camera = wide(scene), camera.astype(np.float64)
    visible = cull.forward(host["position"], host["scaling"], wide_camera)
    activations = mlp.forward(
        host["feature"], host["position"], visible, host["weights"], wide_camera
    )
    gaussians = neural.forward(
        activations.output, visible, host["position"], host["offset"], host["scaling"]
    )
    projected = project.forward(
        gaussians.mean,
        gaussians.scale,
        gaussians.rotation,
        gaussians.opacity,
        wide_camera,
        alpha_cut=RESOLUTION,
    )
    lists = box_lists(projected, *size)
    # where alpha would exceed ALPHA_MAX: only Gaussians that are more opaque than that
    saturated = np.zeros((len(lists.gaussian), TILE_SIZE**2), bool)
    entries = np.flatnonzero(gaussians.opacity[lists.gaussian] > ALPHA_MAX)
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
    saturated[entries] = gaussians.opacity[gaussian, None] * np.exp(-power) > ALPHA_MAX
    decisions = blend.Decisions(
        np.ones((len(lists.gaussian), TILE_SIZE**2), bool),
        saturated,
    )
    behind = background.astype(np.float64)
    image = blend.forward(
        projected, gaussians.color, gaussians.opacity, lists, behind, size, decisions
    ).image
    return ReferenceFrame(
        host, wide_camera, behind, activations, gaussians, projected, lists, decisions, image
    )


def box_lists(projected: project.Projected, width: int, height: int) -> tiles.TileLists:
    """Every Gaussian in every tile that its box touches, by tile, then depth."""
    grid = np.array([-(-width // TILE_SIZE), -(-height // TILE_SIZE)])
    first = np.floor((projected.mean2d - projected.extent) / TILE_SIZE).clip(0, grid - 1)
    last = np.floor((projected.mean2d + projected.extent) / TILE_SIZE).clip(0, grid - 1)
    span = (last - first + 1).astype(np.int64)
    counts = np.where(projected.extent[:, 0] > 0, span[:, 0] * span[:, 1], 0)
    row_range = np.concatenate([[0], np.cumsum(counts)])
    gaussian = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(row_range[-1]) - row_range[gaussian]
    column = first[gaussian, 0].astype(np.int64) + within % span[gaussian, 0]
    line = first[gaussian, 1].astype(np.int64) + within // span[gaussian, 0]
    tile = line * grid[0] + column
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
