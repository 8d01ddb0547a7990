"""What `clgs conformance` hashes beyond the pipeline of a training step: all other kernels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.lab.scenes import (
    TURNED,
    ConformanceScene,
    ExactRandom,
    Tensor,
    named,
)
from clgs.opencl.device import Device
from clgs.ops import (
    adam,
    batch,
    blend,
    density,
    exposure,
    growth,
    mask,
    project,
    quantize,
    tiles,
)
from clgs.ops.general import splats, views
from clgs.options import DEFAULT, RenderOptions, Skips
from clgs.render import channel_picture, tile_groups
from clgs.render.frame import Room, upload_scene, upload_view
from clgs.render.rasterise import blend_backward, check_room, rasterise
from clgs.scene.anchors import AnchorSet
from clgs.scene.gaussians import OrdinaryGaussians

COUNT = 3000
"""Numbers given to the stages of training."""

ROWS = 300
"""Anchors that grow and are pruned."""

FISHEYE_COLORS = 34
"""Two launches, the first with as many colors as fit."""

SCREENS = {
    "antialias": project.ANTIALIASED,
    "enlarge": project.Screen(0.25, 0.0, -0.5, 8.0, 9.0, 1.5),
    "reduce": project.Screen(0.25, 0.0, -0.5, 0.5, 1.0, 0.375),
}
"""Screens that blur in another way than that of training."""


def training_tensors(device: Device) -> Iterator[Tensor]:
    """The stages of training that are no part of the usual step, on numbers."""
    yield from _adam_tensors(device)
    random = ExactRandom(COUNT + 1)
    x = device.upload(random.floats((COUNT // 6, 6), -20.0, 20.0))
    q = device.upload(random.floats((COUNT // 6, 6), 0.5, 8.0))
    yield "quantize", "elements", device.download(quantize.elements(device, x, q))
    yield "quantize", "integers", device.download(quantize.integers(device, x, 8.0))
    curvature = device.upload(random.floats((COUNT,), 0.0, 1.0))
    density.add_curvature(device, curvature, device.upload(random.floats((COUNT,), -1.0, 1.0)))
    yield "density", "curvature", device.download(curvature)
    image, d_picture = (device.upload(random.floats((3, 61, 83), -1.0, 1.0)) for _ in range(2))
    used = device.upload(random.bytes((61, 83)) // np.uint8(128))
    yield "mask", "masked", device.download(mask.forward(device, image, used))
    maps, d_maps = device.upload(random.floats((3, 3, 4), -1.0, 1.0)), device.zeros((3, 3, 4))
    yield "exposure", "picture", device.download(exposure.forward(device, image, maps, 1))
    d_image = exposure.backward(device, image, d_picture, maps, 1, 0.125, d_maps)
    yield "exposure", "d_image", device.download(d_image)
    yield "exposure", "d_maps", device.download(d_maps)
    exposure.centre(device, maps, adam.stop_flag(device))
    yield "exposure", "centred", device.download(maps)
    yield from _growth_tensors(device)


def _adam_tensors(device: Device) -> Iterator[Tensor]:
    random = ExactRandom(COUNT)
    parameter = device.upload(random.floats((COUNT // 6, 6), -1.0, 1.0))
    gradient = random.floats((COUNT // 6, 6), -1.0, 1.0)
    gradient[::3] = 0.0
    trained = adam.Trained(parameter, device.upload(gradient), adam.zero_moments(device, parameter))
    stop = adam.stop_flag(device)
    marks = adam.mark_rows(device, trained.gradient, stop)
    adam.step_rows(device, trained, adam.factors(0.01, 1), stop, marks)
    mean = device.upload(random.floats((COUNT // 6, 6), -1.0, 1.0))
    adam.average(device, mean, parameter, 3, stop)
    gradient[7, 5] = np.inf
    adam.check_finite(device, [parameter, device.upload(gradient)], stop)
    total = device.upload(random.floats((COUNT // 6, 6), -1.0, 1.0))
    batch.add(device, total, trained.gradient, 1 / 3)
    for name, array in {"marks": marks, "rows": parameter, "mean": mean, "stop": stop}.items():
        yield "adam", name, device.download(array)
    yield "batch", "sum", device.download(total)


def _growth_tensors(device: Device) -> Iterator[Tensor]:
    random = ExactRandom(ROWS)
    anchors = AnchorSet(
        random.floats((ROWS, 3), -1.0, 1.0),
        random.floats((ROWS, K_OFFSETS, 3), -1.0, 1.0),
        random.floats((ROWS, FEATURE_DIM), -1.0, 1.0),
        random.floats((ROWS, 6), -3.0, 0.5),
    ).map(device.upload)
    seen = (random.integers(ROWS * (K_OFFSETS + 1)) >> np.uint64(60)).astype(np.int32)
    statistics = density.Statistics(
        opacity_sum=random.floats((ROWS,), 0.0, 8.0),
        visits=seen[:ROWS],
        gradient_sum=random.floats((ROWS, K_OFFSETS), 0.0, 8.0),
        gradient_count=seen[ROWS:].reshape(ROWS, K_OFFSETS),
    ).map(device.upload)
    visible = device.upload(np.arange(0, ROWS, 2, dtype=np.int32))
    output = random.floats((K_OFFSETS, ROWS // 2), -1.0, 1.0)
    output[:, ::5] = -1.0
    growth.hide_undrawn(device, anchors, statistics, visible, device.upload(output))
    slots = growth.asking(device, statistics, 7, 0.5)
    yield "growth", "asking", slots.astype(np.int64)
    yield "growth", "places", growth.places(device, anchors, slots)
    growth.restart(device, statistics, 7)
    gone = growth.prune(device, anchors, statistics, 7, 0.25, 0.0)
    yield "growth", "gone", gone.astype(np.int64)
    for name, array in statistics.items():
        yield "growth", name, device.download(array)
    new = growth.NewAnchors(
        position=random.floats((4, 3), -1.0, 1.0),
        edge=random.floats((4,), -3.0, 0.0),
        first=np.array([0, 1, 3, 6, 8], np.int32),
        parents=np.array([5, 9, 2, 0, 299, 17, 3, 3], np.int32),
    )
    longer = growth.append(device, anchors, new)
    rows = device.upload(np.arange(len(longer) - 1, 0, -3, dtype=np.int32))
    for name, array in longer.items():
        # a NaN has many forms: hidden anchors have their positions in `gone`
        taken = device.download(growth.take(device, array, rows))
        yield "growth", name, np.nan_to_num(taken, nan=0.0)


def room_tensors(device: Device, one: ConformanceScene) -> Iterator[Tensor]:
    """A render as it is made with room to spare, in groups of tiles, without gradients."""
    scene = upload_scene(device, one.scene)
    view = upload_view(device, one.camera, one.scene.settings)
    room = Room(visible=500, gaussians=4000, entries=60_000)
    frame = rasterise(device, scene, view, DEFAULT, room)
    stop = adam.stop_flag(device)
    yield "room", "totals", device.download(check_room(device, frame, stop))
    yield "room", "stop", device.download(stop)
    yield from named(device, "room", frame.gaussians, *["slot", "opacity", "mean", "scale"])
    yield from named(device, "room", frame.tiles, *["tile_range", "gaussian", "row"])
    importance = density.no_importance(device, len(scene.anchors))
    d_opacity = device.upload(ExactRandom(3).floats(frame.gaussians.opacity.shape, -1.0, 1.0))
    visible = frame.activations.visible
    density.add_importance(device, importance, visible, frame.gaussians, d_opacity)
    yield from named(device, "importance", importance, "total", "seen")
    fused = rasterise(device, scene, view, DEFAULT, room, keep=False)
    yield from named(device, "project anchors", fused.projected, *vars(fused.projected))
    unculled = rasterise(device, scene, view, RenderOptions(skips=Skips(anchors=False)))
    yield "cull", "every", device.download(unculled.activations.visible)
    size, projected = view.size, frame.projected
    by_row = tiles.count_by_row(device, projected, size, DEFAULT)
    yield "tiles", "by_row", by_row
    entry = tile_groups.LIST_BYTES[device.specialisation] + tile_groups.BYTES_BY_ENTRY
    options = replace(DEFAULT, max_memory=int(by_row.max()) * entry)
    grouped = rasterise(device, scene, view, options)
    assert grouped.groups is not None
    yield "groups", "image", device.download(grouped.image)
    d_image = device.upload(ExactRandom(5).floats(grouped.image.shape, -1.0, 1.0))
    d = blend_backward(device, grouped, d_image)
    yield from named(device, "groups", d, "d_color", "d_opacity", "d_mean2d", "d_whitening")


def file_tensors(device: Device, one: ConformanceScene) -> Iterator[Tensor]:
    """Ordinary Gaussians as 3DGS stores them, and those of Mip-Splatting."""
    random, count = ExactRandom(COUNT + 3), 700
    stored = OrdinaryGaussians(
        random.floats((count, 3), -1.0, 1.0),
        random.floats((count, 3), -5.0, -2.0),
        random.floats((count, 4), -1.0, 1.0),
        random.floats((count,), -4.0, 4.0),
        random.floats((count, 16, 3), -0.5, 0.5),
    ).map(device.upload)
    view = upload_view(device, one.camera, one.scene.settings)
    frame = rasterise(device, stored, view)
    assert frame.gaussians is not None
    names = ("scale", "rotation", "color", "opacity")
    yield from named(device, "splats forward", frame.gaussians, *names)
    for name, screen in SCREENS.items():
        seen = project.forward(device, frame.gaussians, view.camera, screen=screen)
        yield from named(device, name, seen, "whitening", "extent", "opacity")
    d_image = device.upload(random.floats(frame.image.shape, -1.0, 1.0))
    d_projected = blend.backward(device, frame.projected, frame.blended, d_image)
    d = project.backward(device, frame.gaussians, view.camera, frame.projected, d_projected)
    d_stored = splats.backward(device, stored, view.camera, frame.gaussians, d)
    yield from (("splats backward", name, device.download(v)) for name, v in d_stored.items())


def fisheye_tensors(device: Device) -> Iterator[Tensor]:
    """An equidistant fisheye, of quaternions with compensated opacities, then of covariances."""
    random, size, count = ExactRandom(COUNT + 4), (80, 48), 1200
    matrix = np.eye(4)
    matrix[:3, :3], matrix[2, 3] = TURNED, 1.5
    intrinsics = np.array([[40.0, 0, 38], [0, 44, 25], [0, 0, 1]])
    camera = device.upload(views.pack_camera(matrix, intrinsics, size, 0.01))
    mean, opacity = random.floats((count, 3), -1.0, 1.0), random.floats((count,), 0.0, 1.0)
    scale, quaternion = random.floats((count, 3), 0.01, 0.125), random.floats((count, 4), -1.0, 1.0)
    # multiples of 2^-10, whose sums of products are exact
    axes = np.rint(random.floats((count, 3, 3), -0.125, 0.125) * 1024) / 1024
    covariance = np.einsum("nik,njk->nij", axes, axes)[:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]
    color = device.upload(random.floats((count, FISHEYE_COLORS), 0.0, 1.0))
    background = device.upload(random.floats((FISHEYE_COLORS + 1,), 0.0, 1.0))
    d_image = device.upload(random.floats((48, 80, FISHEYE_COLORS + 1), -1.0, 1.0))
    d_left = device.upload(random.floats((48, 80), -1.0, 1.0))
    for kind, shape, rotation in (
        ("scales", scale, device.upload(quaternion)),
        ("covariances", covariance.astype(np.float32), None),
    ):
        given = views.Splats(
            device.upload(mean), device.upload(shape), rotation, device.upload(opacity)
        )
        lens = views.CameraModel("fisheye", compensated=rotation is not None)
        projected = views.forward(device, given, camera, lens, color, DEFAULT)
        names = ("mean2d", "whitening", "depth", "extent", "opacity")
        yield from named(device, f"fisheye forward ({kind})", projected, *names)
        drawn = channel_picture.draw(device, projected, size, background, True, 0.999, DEFAULT)
        yield f"fisheye forward ({kind})", "image", device.download(drawn.picture.image)
        d = channel_picture.backward(device, drawn, d_image, d_left, absolute=True)
        yield from named(device, f"fisheye channels ({kind})", d, *vars(d))
        made = views.backward(device, given, camera, lens, projected, d, want_camera=True)
        present = [name for name, array in vars(made).items() if array is not None]
        yield from named(device, f"fisheye backward ({kind})", made, *present)
