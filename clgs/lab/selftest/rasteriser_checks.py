"""The stages that ``clgs.rasterization`` alone runs: views, harmonics, channels."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from clgs.constants import ALPHA_CUT
from clgs.lab.selftest.reference_render import Timed, relative_errors, relative_l2
from clgs.opencl.device import Device
from clgs.ops.general import harmonics, views
from clgs.ops.general.channels import ChannelGradients
from clgs.ops.project import Projected
from clgs.options import DEFAULT
from clgs.reference.general import channels as channels_reference
from clgs.reference.general import harmonics as harmonics_reference
from clgs.reference.general import views as views_reference
from clgs.reference.project import Projected as ReferenceProjected
from clgs.render import channel_picture

SIZE = 40, 35
OVERLAPPING, COLORS, ALPHA_MAX = 120, 4, 0.999
UPPER = np.triu_indices(3)


def check_views(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """Gaussians for all kinds of rays and of shapes, and gradients by them and the camera."""
    for model in ("pinhole", "ortho", "fisheye"):
        yield from _check_rays(device, rng, count, model)


def _check_rays(
    device: Device, rng: np.random.Generator, count: int, model: str
) -> Iterator[Timed]:
    """Parallel rays with covariances, else scales and quaternions."""
    parallel = model == "ortho"
    wide = {
        "mean": rng.uniform(-1, 1, (count, 3)),
        "scale": 0.1 * 10 ** rng.uniform(-0.5, 0.5, (count, 3)),
        "rotation": rng.normal(size=(count, 4)),
        "opacity": rng.uniform(0.3, 1, count),
    }
    single = {name: value.astype(np.float32) for name, value in wide.items()}
    wide = {name: value.astype(np.float64) for name, value in single.items()}
    covariance = views_reference.covariances(wide["scale"], wide["rotation"])
    rows = covariance[:, UPPER[0], UPPER[1]].astype(np.float32)
    splats = views.Splats(
        device.upload(single["mean"]),
        device.upload(rows if parallel else single["scale"]),
        None if parallel else device.upload(single["rotation"]),
        device.upload(single["opacity"]),
    )
    matrix = np.eye(4)
    matrix[:3, :3] += rng.normal(0, 0.05, (3, 3))
    matrix[2, 3] = 4
    focal = 20.0 if parallel else 80.0
    intrinsics = np.array([[focal, 0, 31], [0, 1.1 * focal, 33], [0, 0, 1]])
    lens = views.CameraModel(model, compensated=True)
    packed = views.pack_camera(matrix, intrinsics, (64, 64), lens.near)
    camera, none = device.upload(packed), device.empty((count, 0))
    forward = partial(views.forward, device, splats, camera, lens, none, DEFAULT)
    seen, lens64 = forward(), views_reference.CameraModel(model, compensated=True)
    given = wide["mean"], covariance, wide["opacity"], packed, lens64
    wanted, opacity = views_reference.forward(*given)
    errors = relative_errors(device, seen, wanted, ("mean2d", "whitening", "depth", "extent"))
    errors["opacity"] = relative_l2(device.download(seen.opacity), opacity)
    rays = "parallel rays" if parallel else f"rays of a {model}"
    yield "views", f"what is on the screen, {rays}", max(errors.values()), 1e-5, forward

    d = {
        "d_mean2d": rng.normal(size=(count, 2)),
        "d_whitening": rng.normal(size=(count, 3)) * wanted.whitening,
        "d_depth": rng.normal(size=count),
        "d_opacity": rng.normal(size=count),
    }
    d_single = {name: value.astype(np.float32) for name, value in d.items()}
    uploaded = {name: device.upload(value) for name, value in d_single.items()}
    d_seen = ChannelGradients(**uploaded, d_color=none, d_absolute=None)
    backward = partial(views.backward, device, splats, camera, lens, seen, d_seen, True)
    made = backward()
    assert made.d_camera is not None
    expected = views_reference.backward(*given, *(one.astype(float) for one in d_single.values()))
    pairs = [
        (device.download(made.d_mean), expected.d_mean),
        (device.download(made.d_opacity), expected.d_opacity),
        (device.download(made.d_camera).sum(axis=2, dtype=np.float64), expected.d_camera),
    ]
    d_shape = device.download(made.d_shape)
    if made.d_rotation is None:
        both = expected.d_covariance * (2 - np.eye(3))
        pairs.append((d_shape, both[:, UPPER[0], UPPER[1]]))
    else:
        shapes = views_reference.shape_gradients(
            wide["scale"], wide["rotation"], expected.d_covariance
        )
        pairs += zip((d_shape, device.download(made.d_rotation)), shapes, strict=True)
    error = max(relative_l2(one, other) for one, other in pairs)
    yield "views", f"gradients, {rays}", error, 2e-5, backward


def check_harmonics(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """Colors of degree 4, and their gradients."""
    degree, centre = 4, np.array([0.25, -0.5, 4], np.float32)
    mean, d_color = rng.normal(size=(2, count, 3)).astype(np.float32)
    sh = rng.normal(0, 0.3, (count, 25, 3)).astype(np.float32)
    sh[:, 0] += 6  # no color is near 0, where its gradient has a step
    packed = np.concatenate([np.zeros(23, np.float32), centre])
    given = device.upload(mean), device.upload(sh), device.upload(packed), degree
    forward = partial(harmonics.forward, device, *given)
    wide = mean.astype(float), sh.astype(float), centre.astype(float), degree
    color = forward()
    error = relative_l2(device.download(color), harmonics_reference.forward(*wide))
    yield "harmonics", "colors", error, 1e-5, forward
    backward = partial(harmonics.backward, device, *given, color, device.upload(d_color))
    pairs = zip(backward(), harmonics_reference.backward(*wide, d_color.astype(float)), strict=True)
    error = max(relative_l2(device.download(one), other) for one, other in pairs)
    yield "harmonics", "gradients", error, 1e-5, backward


def check_channels(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """A picture of colors and depth, and its gradients; no pair is at the alpha cut."""
    values = _ellipses(rng, min(count, OVERLAPPING))
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    screen = ReferenceProjected(*(wide[n] for n in ("mean2d", "whitening", "depth", "extent")))
    layers = channels_reference.layers(screen, wide["opacity"], SIZE, ALPHA_MAX)
    channel = np.append(wide["color"], wide["depth"][:, None], axis=1)
    background = rng.normal(size=COLORS + 1).astype(np.float32)
    image, left = channels_reference.forward(layers, channel, background.astype(float), SIZE)
    projected = Projected(**{name: device.upload(value) for name, value in values.items()})
    shade = device.upload(background)
    forward = partial(
        channel_picture.draw, device, projected, SIZE, shade, True, ALPHA_MAX, DEFAULT
    )
    drawn = forward()
    error = max(
        relative_l2(device.download(drawn.picture.image), image),
        relative_l2(device.download(drawn.picture.transmittance), left),
    )
    yield "channels", "picture", error, 1e-5, forward

    d_image = rng.normal(size=image.shape).astype(np.float32)
    d_left = rng.normal(size=left.shape).astype(np.float32)
    uploaded = device.upload(d_image), device.upload(d_left)
    backward = partial(channel_picture.backward, device, drawn, *uploaded, True)
    made = backward()
    assert made.d_depth is not None
    d_wide = d_image.astype(np.float64), d_left.astype(np.float64)
    expected = channels_reference.backward(
        layers, screen, wide["opacity"], channel, background.astype(float), *d_wide
    )
    names = ("d_mean2d", "d_whitening", "d_opacity", "d_absolute")
    errors = relative_errors(device, made, expected, names)
    by_channel = [device.download(made.d_color), device.download(made.d_depth)[:, None]]
    errors["d_channel"] = relative_l2(np.concatenate(by_channel, axis=1), expected.d_channel)
    yield "channels", "gradients", max(errors.values()), 2e-5, backward


def _ellipses(rng: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """Ellipses on the screen, of which none has an alpha within 1e-5 of the cut."""
    radius = rng.uniform(2, 9, count)
    skew, stretch = rng.normal(0, 0.4, count), rng.uniform(0.5, 2, count)
    values = {
        "mean2d": rng.uniform(-4, 44, (count, 2)),
        "whitening": np.stack([1 / radius, skew, stretch / radius], axis=1),
        "depth": rng.uniform(1, 9, count),
        "extent": np.full((count, 2), 60.0),
        "color": rng.normal(size=(count, COLORS)),
        "opacity": rng.uniform(0.05, 1, count),
    }
    single = {name: value.astype(np.float32) for name, value in values.items()}
    wide = {name: value.astype(np.float64) for name, value in single.items()}
    screen = ReferenceProjected(*(wide[n] for n in ("mean2d", "whitening", "depth", "extent")))
    layers = channels_reference.layers(screen, wide["opacity"], SIZE, ALPHA_MAX)
    alpha = np.exp(-0.5 * (layers.y1**2 + layers.y2**2)) * wide["opacity"][layers.order, None]
    clear = (np.abs(alpha / ALPHA_CUT - 1) > 1e-5).all(axis=1)
    kept = np.sort(layers.order[clear])
    return {name: value[kept] for name, value in single.items()}
