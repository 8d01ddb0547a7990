"""``clgs.rasterization`` against the float64 references, and what it refuses."""

import pickle
from dataclasses import replace

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
import pytest

import clgs
from clgs.errors import BudgetError
from clgs.options import DEFAULT, PRESETS, RenderOptions
from clgs.reference.general import views
from tests.compare import relative_l2
from tests.render.splat_scene import Reference, scene

CASES = [
    # mode, degree, antialiased, camera model, covariances
    ("RGB", None, False, "pinhole", False),
    ("RGB+ED", 2, True, "pinhole", False),
    ("RGB+D", None, True, "ortho", True),
    ("ED", 0, False, "pinhole", True),
    ("RGB+D", 1, True, "fisheye", False),
    ("RGB+ED", None, False, "fisheye", True),
]


@pytest.mark.slow
@pytest.mark.parametrize(("mode", "degree", "antialiased", "model", "by_covars"), CASES)
def test_agrees_with_references(device, rng, mode, degree, antialiased, model, by_covars):
    given = scene(rng, sh_degree=degree, model=model)
    shown = given["colors"].shape[-1]
    given["backgrounds"] = rng.uniform(0, 1, (2, shown)).astype(np.float32)
    if by_covars:
        covars = views.covariances(given["scales"].astype(float), given["quats"].astype(float))
        given.update(covars=covars.astype(np.float32), quats=None, scales=None)
    image, alpha, meta = clgs.rasterization(
        **given,
        render_mode=mode,
        rasterize_mode="antialiased" if antialiased else "classic",
        camera_model=model,
        absgrad=True,
        device=device,
    )
    d_image = rng.normal(size=image.shape).astype(np.float32)
    d_alpha = rng.normal(size=alpha.shape).astype(np.float32)
    made = meta["record"].backward(d_image, d_alpha)
    totals = {}
    for camera in range(2):
        wanted = Reference(given, camera, mode, antialiased, model)
        assert relative_l2(image[camera], wanted.image) < 1e-5
        assert relative_l2(alpha[camera, ..., 0], wanted.alpha) < 1e-5
        for name, array in wanted.backward(d_image[camera], d_alpha[camera, ..., 0]).items():
            if name in ("means2d", "absgrad", "viewmats", "backgrounds"):
                if array.size:
                    assert relative_l2(made[name][camera], array) < 3e-5, name
            else:
                totals[name] = totals.get(name, 0) + array
    for name, array in totals.items():
        assert relative_l2(made[name], array) < 3e-5, name
    assert made.keys() >= totals.keys()
    assert all(array.shape == given[n].shape for n, array in made.items() if n in given)


@pytest.mark.slow
def test_batches_are_calls_of_their_own(device, rng):
    """Also: colors by camera, and a camera's picture does not depend on the others."""
    scenes = [scene(rng) for _ in range(4)]
    names = ("means", "quats", "scales", "opacities", "viewmats", "Ks")
    stacked = {
        n: np.stack([s[n] for s in scenes]).reshape(2, 2, *scenes[0][n].shape) for n in names
    }
    colors = rng.uniform(0, 1, (2, 2, 2, 40, 3)).astype(np.float32)
    both, _, meta = clgs.rasterization(
        **stacked, colors=colors, width=33, height=27, device=device, packed=False
    )
    made = meta["record"].backward(np.ones_like(both))
    assert meta["means2d"].shape == (2, 2, 2, 40, 2)
    for at, one in enumerate(scenes):
        batch = divmod(at, 2)
        alone = {**one, "colors": colors[batch]}
        image, _, meta = clgs.rasterization(**alone, device=device)
        assert np.array_equal(image, both[batch])
        gradients = meta["record"].backward(np.ones_like(image))
        for name in (*names[:5], "colors"):
            assert np.array_equal(gradients[name], made[name][batch]), name


def test_meta_is_stored_without_its_record(rng):
    meta = clgs.rasterization(**scene(rng))[2]
    stored = pickle.loads(pickle.dumps(meta))
    assert list(stored) == [key for key in meta if key != "record"]
    assert np.array_equal(stored["radii"], meta["radii"])


def test_forms_and_groups_change_no_bit(open_device, rng):
    given = scene(rng)
    results = []
    for form, memory in (("cpu", None), ("gpu", None), ("cpu", 9000)):
        image, alpha, meta = clgs.rasterization(
            **given,
            render_mode="RGB+D",
            absgrad=True,
            rasterize_mode="antialiased",
            device=open_device(form),
            options=RenderOptions(max_memory=memory),
        )
        made = meta["record"].backward(np.ones_like(image), np.ones_like(alpha))
        results.append([image, alpha, meta["isect_ids"], meta["flatten_ids"], *made.values()])
    for other in results[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(results[0], other, strict=True))
    with pytest.raises(BudgetError, match="a row of tiles needs"):
        clgs.rasterization(**given, device=open_device("cpu"), options=RenderOptions(max_memory=9))


@pytest.mark.parametrize("packed", [False, True])
def test_meta_describes_the_pictures(device, rng, packed):
    given = scene(rng)
    given["means"][7, 2] = -9.0  # behind the cameras
    meta = clgs.rasterization(**given, packed=packed, device=device)[2]
    radii, opacities = meta["radii"], meta["opacities"]
    assert {"width", "isect_ids", "means2d", "record"} <= set(meta)
    assert meta.get("nothing") is None
    assert (meta["n_cameras"], meta["n_batches"], meta["tile_width"]) == (2, 1, 3)
    if packed:
        assert 7 not in meta["gaussian_ids"]
        assert (radii > 0).all()
        assert np.array_equal(opacities, given["opacities"][meta["gaussian_ids"]])
        assert sorted(set(meta["camera_ids"].tolist())) == [0, 1]
    else:
        assert meta["gaussian_ids"] is None
        assert radii.shape == (2, 40, 2)
        assert not radii[:, 7].any()
    flat, counts = meta["flatten_ids"], meta["tiles_per_gauss"]
    assert np.array_equal(np.bincount(flat, minlength=counts.size), counts.ravel())
    depths = meta["depths"].ravel()[flat]
    assert np.array_equal(
        (meta["isect_ids"] & 0xFFFFFFFF).astype(np.int32).view(np.float32), depths
    )
    assert (np.diff(meta["isect_ids"]) >= 0).all()
    starts = np.append(meta["isect_offsets"].ravel(), len(flat))
    tiles = meta["isect_ids"] >> 32 & 7
    assert np.array_equal(np.repeat(np.tile(np.arange(6), 2), np.diff(starts)), tiles)


@pytest.mark.parametrize(("count", "cameras"), [(0, 2), (3, 0)])
def test_nothing_to_draw(device, rng, count, cameras):
    given = scene(rng, count, cameras)
    image, alpha, meta = clgs.rasterization(**given, device=device)
    assert image.shape == (cameras, 27, 33, 3)
    assert not image.any()
    made = meta["record"].backward(np.ones_like(image), np.ones_like(alpha))
    assert made["means"].shape == (count, 3)
    assert meta["means2d"].shape == (0, 2)


@pytest.mark.parametrize(
    ("changes", "error", "match"),
    [
        ({"means": np.zeros((40, 2), np.float32)}, ValueError, r"means: shape is \(40, 2\)"),
        ({"means": np.zeros((40, 3))}, TypeError, "means: dtype is float64"),
        ({"means": [[0, 0, 0]]}, TypeError, "means: is list; give a NumPy array"),
        ({"scales": np.full((40, 3), np.nan, np.float32)}, ValueError, "scales: .* not finite"),
        ({"quats": np.zeros((40, 4), np.float32)}, ValueError, "quats: .* length 0"),
        ({"quats": None}, TypeError, "quats: is NoneType"),
        ({"opacities": np.full(40, 1.5, np.float32)}, ValueError, "opacities: .* 0 to 1"),
        ({"colors": np.zeros((40, 0), np.float32)}, ValueError, "colors: .* no channels"),
        ({"colors": np.zeros(40, np.float32)}, ValueError, "colors: shape"),
        ({"sh_degree": 1}, ValueError, "colors: shape"),
        ({"sh_degree": 5}, ValueError, "sh_degree: 5"),
        ({"viewmats": np.zeros((2, 4, 4))}, ValueError, "viewmats: the last row"),
        ({"Ks": np.zeros((2, 3, 3))}, ValueError, "Ks: a focal length"),
        ({"Ks": np.ones((2, 3, 3))}, ValueError, "Ks: a matrix has skew"),
        ({"backgrounds": np.zeros((2, 2), np.float32)}, ValueError, "backgrounds: shape"),
        ({"width": 0}, ValueError, "width: 0"),
        ({"height": 2.0}, TypeError, "height: is float"),
        ({"near_plane": -1}, ValueError, "near_plane: -1"),
        ({"eps2d": "x"}, TypeError, "eps2d: is str"),
        ({"render_mode": "RGBD"}, ValueError, "render_mode: 'RGBD'"),
        ({"render_mode": None}, TypeError, "render_mode: is NoneType"),
        ({"sh_degree": True}, ValueError, "sh_degree: True"),
        ({"means": np.ma.zeros((40, 3), np.float32)}, TypeError, "means: is MaskedArray"),
        ({"viewmats": np.eye(4)[None] * [[1], [1e300], [1], [1]]}, ValueError, "viewmats"),
        ({"far_plane": 1e39}, ValueError, "far_plane: 1e.39 is not a finite float32"),
        ({"packed": "no"}, TypeError, "packed: is 'no'"),
        ({"absgrad": None}, TypeError, "absgrad: is None"),
        ({"with_ut": np.zeros(2)}, NotImplementedError, "with_ut"),
        ({"tile_size": np.zeros(2)}, NotImplementedError, "tile_size"),
        ({"channel_chunk": 0}, ValueError, "channel_chunk: 0"),
        ({"alpha_max": "x"}, TypeError, "alpha_max: is str"),
        ({"options": 3}, TypeError, "options: is int"),
        ({"render_mode": "RGB-Ed"}, NotImplementedError, "render_mode: 'RGB-Ed'"),
        ({"rasterize_mode": "fast"}, ValueError, "rasterize_mode: 'fast'"),
        ({"tile_size": 8}, NotImplementedError, "tile_size: 8 is not offered"),
        ({"sparse_grad": True}, NotImplementedError, "sparse_grad"),
        ({"camera_model": "ftheta"}, NotImplementedError, "camera_model: 'ftheta'"),
        ({"camera_model": "lidar"}, NotImplementedError, "camera_model: 'lidar'"),
        ({"with_ut": True}, NotImplementedError, "with_ut"),
        ({"radial_coeffs": np.zeros(4)}, NotImplementedError, "radial_coeffs"),
        ({"alpha_max": 1.0}, ValueError, "alpha_max"),
        ({"options": replace(DEFAULT, accuracy=PRESETS["exact"])}, ValueError, "inclusive"),
    ],
)  # fmt: skip
def test_what_is_refused(open_device, rng, changes, error, match):
    with pytest.raises(error, match=match):
        clgs.rasterization(**{**scene(rng), **changes}, device=open_device("cpu"))


def test_a_device_that_is_none(rng):
    with pytest.raises(TypeError, match="device: is str"):
        clgs.rasterization(**scene(rng), device="cpu")


def test_gradients_of_the_wrong_shape(open_device, rng):
    image, _, meta = clgs.rasterization(**scene(rng), device=open_device("cpu"))
    with pytest.raises(ValueError, match="d_colors: shape"):
        meta["record"].backward(image[..., :2])
    with pytest.raises(TypeError, match="d_alphas"):
        meta["record"].backward(image, image.astype(np.float64))


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_gradients_are_those_of_central_differences(open_device, rng, model):
    """A sum over a picture in which every pixel sees every Gaussian, along random directions."""
    given = scene(rng, 6, 1, sh_degree=1) | {"camera_model": model}
    given["means"] *= np.float32(0.2)
    given["scales"][:] = 1.5, 2.0, 2.5
    given["opacities"] = given["opacities"] * np.float32(0.3) + np.float32(0.2)
    given["Ks"][:] = np.array([[4.0, 0, 2], [0, 4.0, 2], [0, 0, 1]])
    given.update(width=5, height=4, render_mode="RGB+D", device=open_device("cpu"))
    weight = rng.normal(size=(1, 4, 5, 4)).astype(np.float32)

    def loss(**changed):
        image, alpha, meta = clgs.rasterization(**{**given, **changed})
        return np.vdot(image.astype(float), weight) + alpha.sum(dtype=float), meta

    made = loss()[1]["record"].backward(weight, np.ones((1, 4, 5, 1), np.float32))
    for name in ("means", "quats", "scales", "opacities", "colors", "viewmats"):
        direction = np.sign(made[name]) * rng.uniform(0.5, 1, given[name].shape)
        if name == "viewmats":
            direction[:, 3] = 0
        ends = [
            loss(**{name: (given[name] + step * direction).astype(np.float32)})[0]
            for step in (4e-3, -4e-3)
        ]
        wanted = np.vdot(made[name].astype(float), direction)
        assert (ends[0] - ends[1]) / 8e-3 == pytest.approx(wanted, rel=5e-3), name


@pytest.mark.parametrize(("cameras", "sh_degree"), [(1, None), (2, 3)])
def test_arrays_on_the_device_have_the_bits_of_those_of_numpy(device, rng, cameras, sh_degree):
    given = scene(rng, cameras=cameras, sh_degree=sh_degree)
    lent = {
        name: cl_array.to_device(device.queue, np.ascontiguousarray(value))
        for name, value in given.items()
        if isinstance(value, np.ndarray)
    }
    padded = cl_array.to_device(device.queue, np.append(np.zeros(7, np.float32), given["means"]))
    lent["means"] = padded[7:].reshape(given["means"].shape)  # begins within its buffer
    results, weight = [], None
    for arrays in (given, {**given, **lent}):
        image, alpha, meta = clgs.rasterization(**arrays, render_mode="RGB+D", device=device)
        if weight is None:
            weight = rng.normal(size=image.shape).astype(np.float32)
        else:
            weight = cl_array.to_device(device.queue, weight)
        made = meta["record"].backward(weight)
        results.append([image, alpha, meta["radii"], *made.values()])
    for one, other in zip(*results, strict=True):
        assert np.array_equal(one, other)
    seen = meta["record"].views[0].splats
    assert seen.opacity.buffer is lent["opacities"].base_data
    assert seen.shape.buffer is lent["scales"].base_data


def test_arrays_of_another_context_or_order_are_refused(device, rng):
    given = scene(rng)
    other = cl.CommandQueue(cl.Context([device.cl_device]))
    with pytest.raises(ValueError, match=r"means: .* is of another context"):
        clgs.rasterization(
            **given | {"means": cl_array.to_device(other, given["means"])}, device=device
        )
    turned = cl_array.to_device(device.queue, np.asfortranarray(given["means"]))
    with pytest.raises(ValueError, match=r"means: .* is not contiguous"):
        clgs.rasterization(**given | {"means": turned}, device=device)
    empty = cl_array.to_device(device.queue, np.zeros((0, 3), np.float32))
    with pytest.raises(ValueError, match="opacities: shape"):
        clgs.rasterization(**given | {"means": empty}, device=device)
