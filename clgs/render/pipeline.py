"""From a scene and a camera to a picture, and from the picture's gradient back.

This is the figure of the paper, top to bottom; the backward pass is the same list upside down.
"""

from __future__ import annotations

from dataclasses import astuple

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, cull, loss, mlp, neural, project, project_anchors, scan, tiles
from clgs.options import DEFAULT, RenderOptions
from clgs.render import tile_groups
from clgs.render.frame import (
    Capacity,
    DeviceScene,
    DeviceView,
    Frame,
    Groups,
    Picture,
    SceneGradients,
    upload_view,
)
from clgs.scene.camera import Camera
from clgs.scene.scene import RenderSettings


def render_forward(
    device: Device,
    scene: DeviceScene,
    camera: Camera,
    settings: RenderSettings,
    options: RenderOptions = DEFAULT,
) -> Frame:
    """Render one view.

    ``settings.background`` is drawn where the transmittance is left. The frame holds the picture
    (3, H, W) float32, not clamped, and what :func:`render_backward` needs.
    """
    return view_forward(device, scene, upload_view(device, camera, settings), options)


def view_forward(
    device: Device,
    scene: DeviceScene,
    view: DeviceView,
    options: RenderOptions = DEFAULT,
    capacity: Capacity | None = None,
) -> Frame:
    """As :func:`render_forward`, of a view that lies on the device.

    Nothing is waited for where there is a ``capacity``; :func:`check_capacity` then tells whether
    it was enough. Without one, all arrays are made to measure.
    """
    packed = view.camera
    visible = _cull(device, scene, view, options, capacity)
    with device.stage("mlp forward"):
        activations = mlp.forward(
            device, scene.feature, scene.position, visible.anchor, scene.weights, packed, options
        )
    with device.stage("neural forward"):
        gaussians = neural.forward(
            device,
            activations.output,
            activations.visible,
            scene.position,
            scene.offset,
            scene.scaling,
            capacity.gaussians if capacity else None,
        )
    with device.stage("project forward"):
        shape = (gaussians.mean, gaussians.scale, gaussians.rotation)
        projected = project.forward(device, *shape, gaussians.opacity, packed, options)
    lists, blended, groups = _rasterise(
        device, gaussians, projected, view, options, capacity.entries if capacity else None
    )
    drawn = lists, view.background, blended, groups
    return Frame(packed, view.size, visible, activations, gaussians, projected, *drawn)


def draw(
    device: Device,
    scene: DeviceScene,
    view: DeviceView,
    options: RenderOptions = DEFAULT,
    capacity: Capacity | None = None,
) -> Picture:
    """The picture of :func:`view_forward`, bit by bit, in less time."""
    visible = _cull(device, scene, view, options, capacity)
    with device.stage("project anchors"):
        anchors = project_anchors.Anchors(
            scene.position, scene.offset, scene.feature, scene.scaling
        )
        room = capacity.gaussians if capacity else None
        model = scene.weights, view.camera
        splats = project_anchors.forward(device, anchors, visible.anchor, *model, options, room)
    room = capacity.entries if capacity else None
    lists, blended, _ = _rasterise(device, splats, splats.projected, view, options, room)
    return Picture(blended.image, (visible.total, splats.total, lists.total))


def _cull(
    device: Device,
    scene: DeviceScene,
    view: DeviceView,
    options: RenderOptions,
    capacity: Capacity | None,
) -> cull.Visible:
    with device.stage("cull"):
        room = capacity.visible if capacity else None
        inputs = scene.position, scene.scaling, view.camera
        return cull.forward(device, *inputs, options, room)


def check_capacity(device: Device, frame: Frame, capacity: Capacity, stop: DeviceArray) -> None:
    """Set ``stop`` (1,) int32 where ``capacity`` was too small for the frame."""
    for total, room in zip(frame.totals, astuple(capacity), strict=True):
        scan.check_fits(device, total, room, stop)


def _rasterise(
    device: Device,
    gaussians: neural.NeuralGaussians | project_anchors.Splats,
    projected: project.Projected,
    view: DeviceView,
    options: RenderOptions,
    capacity: int | None,
) -> tuple[tiles.TileLists, blend.Blended, Groups | None]:
    """Draw projected Gaussians; in groups of tiles where the memory budget asks for it."""
    if options.max_memory is not None:
        with device.stage("tiles"):
            groups, total = tile_groups.plan_view(device, projected, gaussians, view.size, options)
            capacity = None
        if len(groups.rows) > 1:
            with device.stage("tiles and blend forward"):
                blended = tile_groups.forward(device, projected, gaussians, view, options, groups)
            count = len(gaussians.opacity)
            return tile_groups.no_lists(device, count, view.size, total), blended, groups
    with device.stage("tiles"):
        lists = tiles.forward(device, projected, gaussians.opacity, *view.size, options, capacity)
    with device.stage("blend forward"):
        colors = gaussians.color, gaussians.opacity
        blended = blend.forward(
            device, projected, *colors, lists, view.background, view.size, options
        )
    return lists, blended, None


def render_backward(
    device: Device,
    scene: DeviceScene,
    frame: Frame,
    d_image: DeviceArray,
    volume_weight: float = 0.0,
) -> SceneGradients:
    """Gradients of ``sum(d_image * image) + volume_weight * mean(prod(scale))``.

    Args:
        device: where everything lives.
        scene: what the frame was rendered from.
        frame: from :func:`render_forward`.
        d_image: (3, H, W) float32.
        volume_weight: weight of the volume term over all neural Gaussians of the frame.
    """
    d_gaussians, d_mean2d = rasterise_backward(device, frame, d_image, volume_weight)
    with device.stage("neural backward"):
        decoded = neural.backward(
            device,
            frame.gaussians,
            frame.activations.output,
            frame.activations.visible,
            scene.offset,
            scene.scaling,
            d_gaussians,
        )
    with device.stage("mlp backward"):
        learned = mlp.backward(
            device,
            frame.activations,
            scene.feature,
            scene.position,
            scene.weights,
            frame.camera,
            decoded.d_output,
        )
    return SceneGradients(
        d_offset=decoded.d_offset,
        d_feature=learned.d_feature,
        d_scaling=decoded.d_scaling,
        d_weights=learned.d_weights,
        d_mean2d=d_mean2d,
    )


def rasterise_backward(
    device: Device, frame: Frame, d_image: DeviceArray, volume_weight: float = 0.0
) -> tuple[neural.GaussianGradients, DeviceArray]:
    """Gradients by the frame's Gaussians, and by their centres (N, 2) on the screen."""
    gaussians = frame.gaussians
    with device.stage("blend backward"):
        splats = blend_backward(device, frame, d_image)
    shape = (gaussians.mean, gaussians.scale, gaussians.rotation)
    with device.stage("project backward"):
        solids = project.backward(
            device, shape, frame.camera, frame.projected, splats.d_mean2d, splats.d_whitening
        )
        if volume_weight:
            loss.volume(device, gaussians.scale, volume_weight, solids.d_scale, gaussians.total)
    d_gaussians = neural.GaussianGradients(
        d_mean=solids.d_mean,
        d_scale=solids.d_scale,
        d_rotation=solids.d_rotation,
        d_color=splats.d_color,
        d_opacity=splats.d_opacity,
    )
    return d_gaussians, splats.d_mean2d


def blend_backward(device: Device, frame: Frame, d_image: DeviceArray) -> blend.BlendGradients:
    """Gradients by what was blended: the projected Gaussians, their colors and opacities."""
    projected, gaussians, background = frame.projected, frame.gaussians, frame.background
    if frame.groups is not None:
        return tile_groups.backward(
            device, projected, gaussians, background, frame.blended, d_image, frame.groups
        )
    colors = gaussians.color, gaussians.opacity
    return blend.backward(
        device, projected, *colors, frame.tiles, background, frame.blended, d_image
    )
