"""From a scene and a camera to a picture, and from the picture's gradient back.

:func:`view_forward` is the figure of the paper, top to bottom; :func:`render_backward` is the same
list upside down. Beside them, ``picture`` draws without keeping what a backward pass needs, and
``tile_groups`` draws within a memory budget.
"""

from __future__ import annotations

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, cull, loss, mlp, neural, project, scan, tiles
from clgs.options import DEFAULT, RenderOptions
from clgs.render import tile_groups
from clgs.render.frame import (
    EXACT_ROOM,
    DeviceScene,
    DeviceView,
    Frame,
    Room,
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

    ``settings.background`` shows through the transmittance that is left. The frame holds the
    picture (3, H, W) float32, not clamped, and what :func:`render_backward` needs.
    """
    return view_forward(device, scene, upload_view(device, camera, settings), options)


def view_forward(
    device: Device,
    scene: DeviceScene,
    view: DeviceView,
    options: RenderOptions = DEFAULT,
    room: Room = EXACT_ROOM,
) -> Frame:
    """As :func:`render_forward`, of a view that lies on the device.

    In a ``room`` without EXACT nothing waits for the device; :func:`check_room` then finds out
    whether it was enough.
    """
    inputs = mlp.Inputs(scene.anchors, scene.weights, view.camera)
    with device.stage("cull"):
        visible = cull.forward(device, scene.anchors, view.camera, options, room.visible)
    with device.stage("mlp forward"):
        activations = mlp.forward(device, inputs, visible.anchor, options)
    with device.stage("neural forward"):
        gaussians = neural.forward(device, activations, scene.anchors, room.gaussians)
    with device.stage("project forward"):
        projected = project.forward(device, gaussians, view.camera, options)
    if options.max_memory is not None:
        blended, groups = tile_groups.forward(device, projected, view, options)
        return Frame(view, visible, activations, gaussians, projected, blended, groups)
    with device.stage("tiles"):
        lists = tiles.forward(device, projected, view.size, options, room.entries)
    with device.stage("blend forward"):
        blended = blend.forward(device, projected, lists, view.background, options)
    return Frame(view, visible, activations, gaussians, projected, blended, None)


def roomy_forward(
    device: Device,
    scene: DeviceScene,
    view: DeviceView,
    options: RenderOptions,
    room: Room,
) -> tuple[Frame, Room]:
    """As :func:`view_forward`, of one view after the other, for which arrays keep their sizes.

    They then share memory, of which exact arrays would take more and more. Give EXACT_ROOM with the
    first view, and then the room that came with the view before.
    """
    while True:
        frame = view_forward(device, scene, view, options, room)
        needed = frame.needed(device)
        if room.holds(needed):
            return frame, room.grown(needed)
        room = room.grown(needed)


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
    with device.stage("blend backward"):
        d_projected = blend_backward(device, frame, d_image)
    return scene_backward(device, scene, frame, d_projected, volume_weight)


def scene_backward(
    device: Device,
    scene: DeviceScene,
    frame: Frame,
    d_projected: project.ProjectedGradients,
    volume_weight: float = 0.0,
) -> SceneGradients:
    """The rest of :func:`render_backward`, from the gradients by the projected Gaussians on."""
    gaussians, camera = frame.gaussians, frame.view.camera
    inputs = mlp.Inputs(scene.anchors, scene.weights, camera)
    with device.stage("project backward"):
        d_gaussians = project.backward(device, gaussians, camera, frame.projected, d_projected)
        if volume_weight:
            total, d_scale = gaussians.total, d_gaussians.d_scale
            loss.volume(device, gaussians.scale, volume_weight, d_scale, total)
    with device.stage("neural backward"):
        decoded = neural.backward(device, gaussians, frame.activations, scene.anchors, d_gaussians)
    with device.stage("mlp backward"):
        learned = mlp.backward(device, inputs, frame.activations, decoded.d_output)
    return SceneGradients(
        d_offset=decoded.d_offset,
        d_feature=learned.d_feature,
        d_scaling=decoded.d_scaling,
        d_weights=learned.d_weights,
        d_mean2d=d_projected.d_mean2d,
    )


def blend_backward(
    device: Device, frame: Frame, d_image: DeviceArray
) -> project.ProjectedGradients:
    """Gradients by the projected Gaussians; in groups of tiles if the picture was drawn so."""
    if frame.groups is not None:
        return tile_groups.backward(device, frame.projected, frame.blended, d_image, frame.groups)
    return blend.backward(device, frame.projected, frame.blended, d_image)


def check_room(device: Device, frame: Frame, room: Room, stop: DeviceArray) -> DeviceArray:
    """Set ``stop`` (1,) int32 if ``room`` was too small; returns ``frame.totals`` as (3,)."""
    return scan.check_fits(device, frame.totals, (room.visible, room.gaussians, room.entries), stop)
