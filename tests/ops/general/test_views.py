"""Projection for any camera against the float64 reference: forward, and every gradient."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.ops.general import views
from clgs.ops.general.channels import ChannelGradients
from clgs.options import DEFAULT
from clgs.reference.general import views as reference
from tests.compare import assert_close, relative_l2

SIZE = (96, 80)
UPPER = np.triu_indices(3)


def matrices(rng):
    """A viewmat that is no rotation, and intrinsics."""
    viewmat = np.eye(4)
    viewmat[:3, :3] += rng.normal(0, 0.08, (3, 3))
    viewmat[:3, 3] = 0.1, -0.2, 4.0
    return viewmat, np.array([[90.0, 0, 45], [0, 100.0, 43], [0, 0, 1]])


def gaussians(rng, count):
    values = {
        "mean": rng.uniform(-2.5, 2.5, (count, 3)),
        "scale": 0.1 * 10 ** rng.uniform(-0.5, 0.5, (count, 3)),
        "rotation": rng.normal(size=(count, 4)) * rng.uniform(0.3, 3, (count, 1)),
        "opacity": rng.uniform(0.02, 1.0, count),
    }
    return {name: value.astype(np.float32) for name, value in values.items()}


def lenses(model, compensated):
    shared = {"blur": 0.25, "far": 5.5, "smallest_radius": 2.0}
    given = views.CameraModel(model, compensated, near=2.0, **shared)
    return given, reference.CameraModel(model, compensated, **shared)


def on_device(device, values, by_covariance):
    mean, opacity = device.upload(values["mean"]), device.upload(values["opacity"])
    if by_covariance:
        shape = reference.covariances(*(values[n].astype(float) for n in ("scale", "rotation")))
        rows = shape[:, UPPER[0], UPPER[1]].astype(np.float32)
        return views.Splats(mean, device.upload(rows), None, opacity)
    shape, rotation = device.upload(values["scale"]), device.upload(values["rotation"])
    return views.Splats(mean, shape, rotation, opacity)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "compensated", "by_covariance"),
    [
        ("pinhole", False, False),
        ("pinhole", True, True),
        ("ortho", True, False),
        ("ortho", False, True),
        ("fisheye", True, False),
        ("fisheye", False, True),
    ],
)
def test_agrees_with_reference(device, rng, model, compensated, by_covariance):
    count = 1500
    values = gaussians(rng, count)
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    covariance = reference.covariances(wide["scale"], wide["rotation"])
    viewmat, intrinsics = matrices(rng)
    if model == "ortho":
        intrinsics[[0, 1], [0, 1]] = 22.0, 25.0
    lens, lens64 = lenses(model, compensated)
    packed = views.pack_camera(viewmat, intrinsics, SIZE, lens.near)
    splats, camera = on_device(device, values, by_covariance), device.upload(packed)
    none = device.empty((count, 0))
    found = views.forward(device, splats, camera, lens, none, DEFAULT)
    wanted, opacity = reference.forward(wide["mean"], covariance, wide["opacity"], packed, lens64)
    drawn = wanted.extent[:, 0] > 0
    assert 0.2 < drawn.mean() < 0.9
    assert np.array_equal(device.download(found.extent)[:, 0] > 0, drawn)
    for name in ("mean2d", "whitening", "depth", "extent"):
        assert relative_l2(device.download(getattr(found, name)), getattr(wanted, name)) < 3e-6
    assert relative_l2(device.download(found.opacity), opacity) < 1e-6

    r1, _, r2 = np.where(wanted.whitening == 0, 1, wanted.whitening).T
    moment = rng.normal(size=(count, 3))
    given = {
        "d_mean2d": rng.normal(size=(count, 2)),
        "d_whitening": np.stack([moment[:, 0] / r1, moment[:, 1] * r2 / r1, moment[:, 2] / r2], 1),
        "d_depth": rng.normal(size=count),
        "d_opacity": rng.normal(size=count),
    }
    given = {name: value.astype(np.float32) for name, value in given.items()}
    uploaded = {name: device.upload(value) for name, value in given.items()}
    d_projected = ChannelGradients(**uploaded, d_color=none, d_absolute=None)
    made = views.backward(device, splats, camera, lens, found, d_projected, want_camera=True)
    expected = reference.backward(
        wide["mean"],
        covariance,
        wide["opacity"],
        packed,
        lens64,
        *(value.astype(np.float64) for value in given.values()),
    )
    assert relative_l2(device.download(made.d_mean), expected.d_mean) < 1e-5
    assert relative_l2(device.download(made.d_opacity), expected.d_opacity) < 1e-5
    by_camera = device.download(made.d_camera)
    assert not by_camera[..., ~drawn].any()
    assert relative_l2(by_camera.sum(axis=2, dtype=np.float64), expected.d_camera) < 1e-5
    if by_covariance:
        both = expected.d_covariance * (2 - np.eye(3))
        assert relative_l2(device.download(made.d_shape), both[:, UPPER[0], UPPER[1]]) < 2e-5
    else:
        d_scale, d_rotation = reference.shape_gradients(
            wide["scale"], wide["rotation"], expected.d_covariance
        )
        assert relative_l2(device.download(made.d_shape), d_scale) < 1e-5
        assert relative_l2(device.download(made.d_rotation), d_rotation) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("by_covariance", [False, True])
def test_what_gets_no_gradient_has_zeros_without_a_sign(device, rng, by_covariance):
    """Compilers may choose the sign of a zero that a formula gives: Mesa's chooses another."""
    count, (lens, _) = 60, lenses("pinhole", compensated=False)
    viewmat, intrinsics = matrices(rng)
    camera = device.upload(views.pack_camera(viewmat, intrinsics, SIZE, lens.near))
    splats = on_device(device, gaussians(rng, count), by_covariance)
    none = device.empty((count, 0))
    found = views.forward(device, splats, camera, lens, none, DEFAULT)
    assert device.download(found.extent).any()
    shapes = {"d_mean2d": (count, 2), "d_whitening": (count, 3), "d_depth": (count,)}
    zeros = {
        name: device.upload(rng.choice(np.float32([0.0, -0.0]), shape))
        for name, shape in (shapes | {"d_opacity": (count,)}).items()
    }
    given = ChannelGradients(**zeros, d_color=none, d_absolute=None)
    made = views.backward(device, splats, camera, lens, found, given, want_camera=True)
    for name, array in vars(made).items():
        if array is not None:
            assert not device.download(array).view(np.uint32).any(), name


@pytest.mark.slow
@pytest.mark.parametrize("by_covariance", [False, True])
def test_a_fisheye_sees_the_axis_and_almost_90_degrees(device, rng, by_covariance):
    """Points on the axis, close to it, at 45 degrees and far beyond; what is behind is culled."""
    tilt = np.array([0, 0, 1e-12, 1e-5, 1e-3, 0.02, 0.3, 0.7, np.pi / 4, 0.9, 1.3, 1.57, 1.6, 3.1])
    turn, distance = rng.uniform(0, 6, len(tilt)), rng.uniform(1, 3, len(tilt))
    across = np.sin(tilt) * [np.cos(turn), np.sin(turn)]
    mean = (distance * [*across, np.cos(tilt)]).T
    values = gaussians(rng, len(tilt)) | {"mean": mean.astype(np.float32)}
    values["opacity"][:] = 0.9
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    shape = reference.covariances(wide["scale"], wide["rotation"])
    lens, lens64 = views.CameraModel("fisheye", near=1e-4), reference.CameraModel("fisheye")
    intrinsics = np.array([[30.0, 0, 48], [0, 25, 40], [0, 0, 1]])
    packed = views.pack_camera(np.eye(4), intrinsics, SIZE, lens.near)
    wanted = reference.forward(wide["mean"], shape, wide["opacity"], packed, lens64)[0]
    assert np.array_equal(wanted.extent[:, 0] > 0, tilt < np.pi / 2)
    angle = np.hypot(*((wanted.mean2d - [48, 40]) / [30, 25]).T)[:12]
    assert np.abs(angle - tilt[:12]).max() < 1e-6
    splats, camera = on_device(device, values, by_covariance), device.upload(packed)
    none = device.empty((len(tilt), 0))
    found = views.forward(device, splats, camera, lens, none, DEFAULT)
    for name in ("mean2d", "whitening", "depth", "extent"):
        assert_close(device.download(getattr(found, name)), getattr(wanted, name), 3e-5, name)
    d = {"d_mean2d": (len(tilt), 2), "d_whitening": (len(tilt), 3), "d_opacity": (len(tilt),)}
    d = {name: rng.normal(size=size).astype(np.float32) for name, size in d.items()}
    uploaded = {name: device.upload(value) for name, value in d.items()}
    d_seen = ChannelGradients(**uploaded, d_depth=None, d_color=none, d_absolute=None)
    made = device.download(views.backward(device, splats, camera, lens, found, d_seen).d_mean)
    by = [d["d_mean2d"], d["d_whitening"], np.zeros(len(tilt)), d["d_opacity"]]
    expected = reference.backward(wide["mean"], shape, wide["opacity"], packed, lens64, *by).d_mean
    for one, other in zip(made[:12], expected[:12], strict=True):
        assert relative_l2(one, other) < 1e-5
    assert not made[12:].any()


def test_boxes_of_a_reach_do_not_depend_on_the_opacity(device, rng):
    values = gaussians(rng, 700)
    values["opacity"][::3] = 0.001
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    packed = views.pack_camera(*matrices(rng), SIZE, 0.01)
    shape = reference.covariances(wide["scale"], wide["rotation"])
    lens = reference.CameraModel(compensated=True, reach=3.33)
    wanted, opacity = reference.forward(wide["mean"], shape, wide["opacity"], packed, lens)
    splats, camera = on_device(device, values, False), device.upload(packed)
    given = views.CameraModel(compensated=True, reach=3.33)
    found = views.forward(device, splats, camera, given, device.empty((700, 0)), DEFAULT)
    assert (wanted.extent[::3, 0] > 0).any()
    assert relative_l2(device.download(found.extent), wanted.extent) < 3e-6
    assert relative_l2(device.download(found.opacity), opacity) < 1e-6


@pytest.mark.parametrize("by_covariance", [False, True])
def test_depths_tell_which_numbers_cannot_be_used(device, rng, by_covariance):
    """Gaussians before the camera and behind it are marked; no other changes."""
    count = 16 + 2 * device.lanes + 3
    values = gaussians(rng, count)
    values["mean"][1::2, 2] = -9
    packed = views.pack_camera(*matrices(rng), SIZE, 0.01)
    camera, none, lens = device.upload(packed), device.empty((count, 0)), views.CameraModel()
    clean = views.forward(
        device, on_device(device, values, by_covariance), camera, lens, none, DEFAULT
    )
    wrong = [("mean", np.nan), ("mean", -np.inf), ("scale", np.inf), ("scale", np.nan)]
    wrong += [("opacity", value) for value in (np.nan, np.inf, -0.001, 1.001)]
    wrong += [] if by_covariance else [("rotation", np.nan), ("rotation", np.inf)]
    for at, (name, value) in enumerate(wrong):
        values[name][at : at + 1].flat[-1] = value
    if not by_covariance:
        values["rotation"][len(wrong)] = 0.0
    values["opacity"][count - 1] = 1.0
    bad = np.arange(count) < len(wrong) + (not by_covariance)
    with np.errstate(all="ignore"):
        splats = on_device(device, values, by_covariance)
        wide = {name: value.astype(np.float64) for name, value in values.items()}
        shape = reference.covariances(wide["scale"], wide["rotation"])
    found = views.forward(device, splats, camera, lens, none, DEFAULT)
    wanted, _ = reference.forward(
        wide["mean"], shape, wide["opacity"], packed, reference.CameraModel()
    )
    depth = device.download(found.depth)
    assert np.array_equal(np.isnan(depth), bad)
    assert np.array_equal(np.isnan(wanted.depth), bad)
    for name in ("mean2d", "whitening", "depth"):
        old, new = (device.download(getattr(one, name)) for one in (clean, found))
        assert np.array_equal(old[~bad][:-1], new[~bad][:-1])


def test_flat_covariances_have_gradients(device):
    """A disk and a point: their Cholesky factors have columns of zeros."""
    rows = np.array([[0.01, 0, 0, 0.02, 0, 0], [0, 0, 0, 0, 0, 0]], np.float32)
    splats = views.Splats(
        device.zeros((2, 3)), device.upload(rows), None, device.upload(np.ones(2, np.float32))
    )
    viewmat, intrinsics = matrices(np.random.default_rng(1))
    camera = device.upload(views.pack_camera(viewmat, intrinsics, SIZE, 0.1))
    none, ones = device.empty((2, 0)), device.upload(np.ones((2, 3), np.float32))
    found = views.forward(device, splats, camera, views.CameraModel(), none, DEFAULT)
    assert (device.download(found.extent) > 0).all()
    made = views.backward(
        device,
        splats,
        camera,
        views.CameraModel(),
        found,
        ChannelGradients(device.zeros((2, 2)), ones, device.zeros((2,)), none, None, None),
        want_camera=True,
    )
    for array in (made.d_mean, made.d_shape, made.d_camera):
        assert np.isfinite(device.download(array)).all()


def test_wrong_arrays_and_none(device, rng):
    viewmat, intrinsics = matrices(rng)
    camera = device.upload(views.pack_camera(viewmat, intrinsics, SIZE, 0.1))
    few = on_device(device, gaussians(rng, 3), False)
    empty = on_device(device, gaussians(rng, 0), False)
    none = device.empty((0, 0))
    found = views.forward(device, empty, camera, views.CameraModel(), none, DEFAULT)
    assert device.download(found.mean2d).shape == (0, 2)
    wrong = views.Splats(few.mean, few.shape, None, few.opacity)
    with pytest.raises(ValueError, match="shape"):
        views.forward(device, wrong, camera, views.CameraModel(), none, DEFAULT)
