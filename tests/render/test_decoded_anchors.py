"""``clgs.decode_anchors``: against float64, central differences, and the trainer's own picture."""

from dataclasses import replace

import numpy as np
import pytest

import clgs
from clgs import constants
from clgs.lab.scenes import anchor_scene
from clgs.reference import cull, mlp, neural
from clgs.render.frame import upload_scene, upload_view
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.scene.anchors import Anchors
from clgs.scene.mlps import Mlps
from clgs.scene.scene import Scene
from tests.compare import central_difference, relative_l2
from tests.ops.cases.mlp import anchors, decided
from tests.ops.cases.neural import case
from tests.ops.cases.project import camera_at

FIELDS = {
    "means": "mean",
    "quats": "rotation",
    "scales": "scale",
    "opacities": "opacity",
    "colors": "color",
}
BY = ("offset", "feature", "scaling", "weights")


def some_scene(rng, count=60):
    """A scene of whose anchors some lie outside of the picture, and rounding decides nothing."""
    values = anchors(rng, count)
    kept = decided(values)
    rest = case(rng, 1, count)
    arrays = values["position"] * 1.5, rest["offset"] * 0.3, values["feature"], rest["scaling"]
    return Scene(Anchors(*(array[kept] for array in arrays)), Mlps(values["weights"]))


def reference(scene, camera, changes=None):
    """The stages in float64: Gaussians, activations, and what they were made of."""
    wide = {name: array.astype(np.float64) for name, array in scene.anchors.items()}
    wide |= {"weights": scene.mlps.flat.astype(np.float64), **(changes or {})}
    packed = camera.pack(scene.settings.near)
    visible = cull.forward(scene.anchors.position, scene.anchors.scaling, packed)
    activations = mlp.forward(wide["feature"], wide["position"], visible, wide["weights"], packed)
    geometry = (wide[name] for name in ("position", "offset", "scaling"))
    return neural.forward(activations.output, visible, *geometry), activations, wide


def reference_gradients(scene, camera, d):
    gaussians, activations, wide = reference(scene, camera)
    visible = activations.visible
    given = neural.GaussianGradients(**{f"d_{FIELDS[name]}": d[name] for name in FIELDS})
    d_output, d_offset, d_scaling = neural.backward(
        gaussians, activations.output, visible, wide["offset"], wide["scaling"], given
    )
    d_weights, d_feature = mlp.backward(
        activations, len(wide["position"]), wide["weights"], d_output
    )
    return dict(zip(BY, (d_offset, d_feature, d_scaling, d_weights), strict=True))


def in_order(scene, camera, found):
    """The numbers in ``found`` of the Gaussians of the reference."""
    gaussians, activations, _ = reference(scene, camera)
    k = constants.K_OFFSETS
    wanted = activations.visible[gaussians.slot // k] * k + gaussians.slot % k
    made = found.anchor_ids * k + found.offset_ids
    assert sorted(made) == sorted(wanted)
    return np.argsort(made)[np.argsort(np.argsort(wanted))]


def random_gradients(rng, found):
    shapes = {name: getattr(found, name).shape for name in FIELDS}
    return {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}


def test_values_and_gradients_match_float64(device, rng):
    scene, camera = some_scene(rng), camera_at()
    found = clgs.decode_anchors(scene, camera, device)
    assert 0 < len(set(found.anchor_ids)) < len(scene.anchors)
    order, (wanted, _, _) = in_order(scene, camera, found), reference(scene, camera)
    for name, other in FIELDS.items():
        assert relative_l2(getattr(found, name)[order], getattr(wanted, other)) <= 1e-6, name
    d = random_gradients(rng, found)
    made = found.backward(*d.values())
    expected = reference_gradients(scene, camera, {name: d[name][order] for name in FIELDS})
    for name in BY:
        assert np.abs(expected[name]).max() > 0, name
        assert relative_l2(made[name], expected[name]) <= 1e-5, name


@pytest.mark.parametrize("name", BY)
def test_reference_matches_central_differences(rng, name):
    scene, camera = some_scene(rng, 12), camera_at()
    gaussians, _, wide = reference(scene, camera)
    d = {n: rng.normal(size=getattr(gaussians, other).shape) for n, other in FIELDS.items()}
    found = reference_gradients(scene, camera, d)[name]

    def loss(moved):
        made = reference(scene, camera, {name: moved})[0]
        return float(sum(np.sum(d[n] * getattr(made, other)) for n, other in FIELDS.items()))

    largest = np.argsort(np.abs(found), axis=None)[-40:]
    indices = [np.unravel_index(at, found.shape) for at in largest]
    numeric = central_difference(loss, wide[name], indices=indices)
    analytic = np.array([found[at] for at in indices])
    assert np.abs(analytic - numeric).max() <= 1e-6 * np.abs(analytic).max()


@pytest.mark.slow
def test_with_rasterization_it_has_the_trainers_picture_and_gradients(device, rng):
    scene, camera = anchor_scene(3000, 96, 7)
    found = clgs.decode_anchors(scene, camera, device)
    viewmats, intrinsics = np.eye(4)[None], np.eye(3)[None]
    viewmats[0, :3, :3], viewmats[0, :3, 3] = camera.rotation, camera.translation
    intrinsics[0, [0, 1, 0, 1], [0, 1, 2, 2]] = camera.fx, camera.fy, camera.cx, camera.cy
    arrays = (found.means, found.quats, found.scales, found.opacities, found.colors)
    image, _, meta = clgs.rasterization(
        *arrays,
        viewmats,
        intrinsics,
        camera.width,
        camera.height,
        near_plane=scene.settings.near,
        alpha_max=constants.ALPHA_MAX,
        device=device,
    )
    uploaded = upload_scene(device, scene)
    frame = rasterise(device, uploaded, upload_view(device, camera, scene.settings))
    wanted = device.download(frame.image).transpose(1, 2, 0)
    assert np.quantile(np.abs(image[0] - wanted), 0.999) <= 1e-6
    d_image = rng.normal(size=image.shape).astype(np.float32)
    d_planes = device.upload(np.ascontiguousarray(d_image[0].transpose(2, 0, 1)))
    expected = rasterise_backward(device, uploaded, frame, d_planes)
    d = meta["record"].backward(d_image)
    made = found.backward(*(d[name] for name in FIELDS))
    for name in BY:
        wanted = device.download(getattr(expected, f"d_{name}"))
        assert np.abs(wanted).max() > 0, name
        assert relative_l2(made[name], wanted) <= 1e-5, name


def test_gradients_that_are_not_given_are_zeros(rng):
    found = clgs.decode_anchors(some_scene(rng), camera_at())
    assert not any(array.any() for array in found.backward().values())
    d_colors = rng.normal(size=found.colors.shape).astype(np.float32)
    made = found.backward(d_colors=d_colors)
    assert made["weights"].any()
    assert made["feature"].any()
    assert not made["offset"].any()


@pytest.mark.parametrize("count", [0, 5])
def test_nothing_is_seen(rng, count):
    scene = some_scene(rng)
    behind = scene.anchors.map(lambda array: array[:count])
    behind = replace(behind, position=behind.position - np.float32(100))
    found = clgs.decode_anchors(replace(scene, anchors=behind), camera_at())
    assert len(found) == 0
    assert found.means.shape == found.colors.shape == (0, 3)
    made = found.backward()
    assert made["feature"].shape == behind.feature.shape
    assert not any(array.any() for array in made.values())


def changed(scene, name, change):
    return replace(scene, anchors=replace(scene.anchors, **{name: change}))


def test_what_is_refused(rng):
    scene, camera = some_scene(rng), camera_at()
    bad = scene.anchors.feature.copy()
    bad[2, 3] = np.nan
    count = len(scene.anchors)
    with pytest.raises(ValueError, match=rf"feature: \({count}, 50\) has numbers that are not"):
        clgs.decode_anchors(changed(scene, "feature", bad), camera)
    with pytest.raises(ValueError, match=r"weights: shape is \(7,\), expected \(13710\)"):
        clgs.decode_anchors(replace(scene, mlps=Mlps(scene.mlps.flat[:7])), camera)
    with pytest.raises(TypeError, match="weights: dtype is float64, expected float32"):
        clgs.decode_anchors(replace(scene, mlps=Mlps(scene.mlps.flat.astype(float))), camera)
    with pytest.raises(TypeError, match="scene: is Anchors, Scene is needed"):
        clgs.decode_anchors(scene.anchors, camera)
    with pytest.raises(TypeError, match="camera: is ndarray, Camera is needed"):
        clgs.decode_anchors(scene, np.eye(4))
    found = clgs.decode_anchors(scene, camera)
    with pytest.raises(ValueError, match=r"d_quats: shape is \(2, 4\), expected \(N, 4\)"):
        found.backward(d_quats=np.zeros((2, 4), np.float32))
    with pytest.raises(TypeError, match="d_means: dtype is float64, expected float32"):
        found.backward(np.zeros(found.means.shape))
    with pytest.raises(TypeError, match="d_colors: is list"):
        found.backward(d_colors=[0.0])
