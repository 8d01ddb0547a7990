"""The picture that a camera sees of a scene, and the gradients of the scene by the picture.

:func:`rasterise` names every stage once, in the order of the paper's figure.
:func:`rasterise_backward` is the same list upside down.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, replace
from typing import TypeVar, overload

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import (
    blend,
    cull,
    loss,
    mlp,
    neural,
    project,
    project_anchors,
    scan,
    tiles,
)
from clgs.ops.general import splats
from clgs.options import DEFAULT, RenderOptions
from clgs.render import tile_groups
from clgs.render.frame import (
    EXACT_ROOM,
    DeviceScene,
    DeviceView,
    Drawable,
    Frame,
    RenderedView,
    Room,
    SceneGradients,
    StoredGradients,
)
from clgs.scene.gaussians import DeviceGaussians, OrdinaryGaussians

AnyView = TypeVar("AnyView", bound=RenderedView)
Recolor = Callable[[project.Projected], DeviceArray]


@overload
def rasterise(
    device: Device,
    scene: DeviceScene,
    view: DeviceView,
    options: RenderOptions = DEFAULT,
    room: Room = EXACT_ROOM,
) -> Frame: ...


@overload
def rasterise(
    device: Device,
    scene: Drawable,
    view: DeviceView,
    options: RenderOptions = DEFAULT,
    room: Room = EXACT_ROOM,
    *,
    keep: bool = True,
    recolor: Recolor | None = None,
) -> RenderedView: ...


def rasterise(
    device: Device,
    scene: Drawable,
    view: DeviceView,
    options: RenderOptions = DEFAULT,
    room: Room = EXACT_ROOM,
    *,
    keep: bool = True,
    recolor: Recolor | None = None,
) -> RenderedView:
    """Draw one view of anchors or of ordinary Gaussians.

    Args:
        device: where the arrays live.
        scene: what is drawn.
        view: its background shows through the transmittance that is left.
        options: accuracy, skips and memory budget.
        room: lengths of the arrays. If none is EXACT and there is no memory budget, nothing waits
            for the device; :func:`check_room` or :func:`with_enough_room` finds out whether
            everything fitted. A memory budget makes the tile lists as long as they need to be.
        keep: whether to keep what :func:`rasterise_backward` needs. If not, one fused stage takes
            the place of those from ``mlp`` to ``project``, faster, and anchors are drawn for
            ``view.screen``; on the usual screen it is the same picture.
        recolor: gives the colors (N, 3) float32 to blend instead of those of the Gaussians; the
            backward pass takes them for those.

    Returns:
        A :class:`Frame` of anchors if it keeps what the backward pass needs, else a
        :class:`RenderedView`.

    Raises:
        BudgetError: a row of tiles needs more than ``options.max_memory``.
    """
    camera = view.camera
    gaussians: neural.Gaussians | None = None
    frame: tuple[neural.NeuralGaussians, mlp.Activations] | None = None
    screen = project.USUAL_SCREEN
    if isinstance(scene, DeviceScene):
        inputs = mlp.Inputs(scene.anchors, scene.weights, camera)
        with device.stage("cull"):
            visible = cull.forward(device, scene.anchors, camera, options, room.visible)
        if keep:
            with device.stage("mlp forward"):
                activations = mlp.forward(device, inputs, visible.anchor, options)
            with device.stage("neural forward"):
                gaussians = neural.forward(device, activations, scene.anchors, room.gaussians)
            frame, total = (gaussians, activations), gaussians.total
        else:
            with device.stage("project anchors"):
                projected, total = project_anchors.forward(
                    device, inputs, visible.anchor, options, room.gaussians, view.screen
                )
        totals = visible.total, total
    else:
        with device.stage("splats forward"):
            gaussians = splats.forward(device, scene, camera)
        if scene.antialiased:
            screen = project.ANTIALIASED
        total = device.upload(np.array([len(scene)], np.int64))
        totals = total, total
    if gaussians is not None:
        with device.stage("project forward"):
            projected = project.forward(device, gaussians, camera, options, screen)
    if recolor is not None:
        projected = replace(projected, color=recolor(projected))

    def draw_rows(entries: int, rows: tuple[int, int] | None) -> blend.Blended:
        with device.stage("tiles"):
            lists = tiles.forward(device, projected, view.size, options, entries, rows)
        with device.stage("blend forward"):
            return blend.forward(device, projected, lists, view.background, options)

    groups = None
    if options.max_memory is not None:
        room = replace(room, entries=scan.EXACT)
        with device.stage("tiles"):
            groups = tile_groups.within_budget(device, projected, view.size, options)
    if groups is None:
        blended = draw_rows(room.entries, None)
    else:
        count = len(projected.opacity)
        blended = tile_groups.draw(device, count, view, options, groups, draw_rows)
    made = view, room, (*totals, blended.tiles.total), projected, blended, groups
    return RenderedView(*made, gaussians) if frame is None else Frame(*made, *frame)


@overload
def rasterise_backward(
    device: Device,
    scene: DeviceScene,
    frame: Frame,
    d_image: DeviceArray,
    volume_weight: float = 0.0,
    by_weights: bool = True,
) -> SceneGradients: ...


@overload
def rasterise_backward(
    device: Device,
    scene: DeviceGaussians,
    frame: RenderedView,
    d_image: DeviceArray,
    volume_weight: float = 0.0,
) -> StoredGradients: ...


def rasterise_backward(
    device: Device,
    scene: Drawable,
    frame: RenderedView,
    d_image: DeviceArray,
    volume_weight: float = 0.0,
    by_weights: bool = True,
) -> SceneGradients | StoredGradients:
    """Gradients of ``sum(d_image * image) + volume_weight * mean(prod(scale))``.

    ``frame`` is what :func:`rasterise` made of ``scene``; ``d_image``: (3, H, W) float32. The mean
    is over all Gaussians of the frame. Without ``by_weights`` the gradient by the weights of the
    MLPs is left out, as 0, which is faster.

    Raises:
        ValueError: the frame does not keep what this needs, or is not of ``scene``.
    """
    camera, gaussians = frame.view.camera, frame.gaussians
    if gaussians is None:
        raise ValueError("frame: it was drawn without `keep`")
    antialiased = isinstance(scene, OrdinaryGaussians) and scene.antialiased
    d_projected = blend_backward(device, frame, d_image)
    with device.stage("project backward"):
        d_gaussians = project.backward(
            device, gaussians, camera, frame.projected, d_projected, antialiased
        )
        if volume_weight:
            total, d_scale = frame.totals[1], d_gaussians.d_scale
            loss.volume(device, gaussians.scale, volume_weight, d_scale, total)
    if isinstance(scene, OrdinaryGaussians):
        with device.stage("splats backward"):
            d_stored = splats.backward(device, scene, camera, gaussians, d_gaussians)
        return StoredGradients(d_stored, d_projected)
    if not isinstance(frame, Frame):
        raise ValueError("frame: it is of ordinary Gaussians, but the scene is one of anchors")
    with device.stage("neural backward"):
        d_neural = neural.backward(
            device, frame.gaussians, frame.activations, scene.anchors, d_gaussians
        )
    with device.stage("mlp backward"):
        inputs = mlp.Inputs(scene.anchors, scene.weights, camera)
        d_mlp = mlp.backward(device, inputs, frame.activations, d_neural.d_output, by_weights)
    return SceneGradients(
        d_offset=d_neural.d_offset,
        d_feature=d_mlp.d_feature,
        d_scaling=d_neural.d_scaling,
        d_weights=d_mlp.d_weights,
        d_projected=d_projected,
    )


def blend_backward(
    device: Device, frame: RenderedView, d_image: DeviceArray
) -> project.ProjectedGradients:
    """The first stage of :func:`rasterise_backward`: gradients by the projected Gaussians."""
    with device.stage("blend backward"):
        if frame.groups is None:
            return blend.backward(device, frame.projected, frame.blended, d_image)
        return tile_groups.backward(device, frame.projected, frame.blended, d_image, frame.groups)


def check_room(device: Device, frame: RenderedView, stop: DeviceArray) -> DeviceArray:
    """Set ``stop`` (1,) int32 if something did not fit; returns ``frame.totals`` as (3,) int64.

    Waits for nothing.
    """
    return scan.check_fits(device, frame.totals, astuple(frame.room), stop)


def with_enough_room(
    draw: Callable[..., AnyView],
    device: Device,
    scene: Drawable,
    view: DeviceView,
    options: RenderOptions,
    room: Room,
) -> tuple[AnyView, Room]:
    """What ``draw`` makes in ``room``, or in a larger one if something did not fit.

    ``draw``: such as :func:`rasterise`, whose arguments follow. Waits for the device.

    Returns:
        The picture, and the room for the next one. Arrays of the same lengths take the same memory
        for picture after picture, and nothing waits for the device between their stages.
    """
    while True:
        picture = draw(device, scene, view, options, room)
        needed = picture.needed(device)
        if picture.room.holds(needed):
            return picture, room.grown(needed)
        room = room.grown(needed)
        del picture  # before the next one is made


def draw_depth(
    device: Device,
    scene: Drawable,
    view: DeviceView,
    options: RenderOptions = DEFAULT,
    room: Room = EXACT_ROOM,
) -> RenderedView:
    """The picture if the color of every Gaussian were (depth / largest depth, 1, 0), over black.

    Blending is linear in the colors: the first channel is the sum of depths weighted as colors are,
    in units of :func:`largest_depth`, since blending clamps colors to +-1000; the second channel is
    the sum of the weights. Arguments as for :func:`rasterise`. Waits for the device.
    """

    def depth_as_color(projected: project.Projected) -> DeviceArray:
        depth = device.download(projected.depth)
        share = depth / np.float32(largest_depth(device, projected))
        return device.upload(np.stack([share, np.ones_like(depth), np.zeros_like(depth)], 1))

    dark = replace(view, background=device.zeros((3,)))
    return rasterise(device, scene, dark, options, room, keep=False, recolor=depth_as_color)


def largest_depth(device: Device, projected: project.Projected) -> float:
    """Largest depth of all Gaussians, scene units; 1 if nothing is drawn."""
    return float(device.download(projected.depth).max(initial=0.0)) or 1.0
