"""From a scene and a camera to a picture, and from the picture's gradient back.

This is the figure of the paper, top to bottom; the backward pass is the same list upside down.
"""

from __future__ import annotations

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import blend, cull, loss, mlp, neural, project, tiles
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import DeviceScene, DeviceView, Frame, SceneGradients, upload_view
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
    device: Device, scene: DeviceScene, view: DeviceView, options: RenderOptions = DEFAULT
) -> Frame:
    """As :func:`render_forward`, of a view that lies on the device."""
    packed, size, background = view.camera, view.size, view.background
    with device.stage("cull"):
        visible = cull.forward(device, scene.position, scene.scaling, packed)
    with device.stage("mlp forward"):
        activations = mlp.forward(
            device, scene.feature, scene.position, visible, scene.weights, packed, options
        )
    with device.stage("neural forward"):
        gaussians = neural.forward(
            device,
            activations.output,
            activations.visible,
            scene.position,
            scene.offset,
            scene.scaling,
        )
    projected, lists, blended = _rasterise(device, gaussians, packed, background, size, options)
    return Frame(packed, size, activations, gaussians, projected, lists, background, blended)


def _rasterise(
    device: Device,
    gaussians: neural.NeuralGaussians,
    packed: DeviceArray,
    background: DeviceArray,
    size: tuple[int, int],
    options: RenderOptions,
) -> tuple[project.Projected, tiles.TileLists, blend.Blended]:
    """Draw neural Gaussians."""
    with device.stage("project forward"):
        projected = project.forward(
            device,
            gaussians.mean,
            gaussians.scale,
            gaussians.rotation,
            gaussians.opacity,
            packed,
            options,
        )
    with device.stage("tiles"):
        lists = tiles.forward(device, projected, gaussians.opacity, *size, options)
    with device.stage("blend forward"):
        blended = blend.forward(
            device,
            projected,
            gaussians.color,
            gaussians.opacity,
            lists,
            background,
            size,
            options,
        )
    return projected, lists, blended


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
    d_gaussians, d_mean2d = _rasterise_backward(device, frame, d_image, volume_weight)
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


def _rasterise_backward(
    device: Device, frame: Frame, d_image: DeviceArray, volume_weight: float
) -> tuple[neural.GaussianGradients, DeviceArray]:
    """Gradients of the neural Gaussians, and those of their centres on the screen."""
    gaussians = frame.gaussians
    with device.stage("blend backward"):
        splats = blend.backward(
            device,
            frame.projected,
            gaussians.color,
            gaussians.opacity,
            frame.tiles,
            frame.background,
            frame.blended,
            d_image,
        )
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
