"""Files of splats as other programs write them, drawn as they are meant: against float64."""

import math
from dataclasses import replace

import numpy as np
import pytest

from clgs.constants import ALPHA_MAX, BLUR, NEAR_PLANE
from clgs.data.origin import move_camera
from clgs.data.splats.gaussians import load_splats
from clgs.data.splats.ply import read_ply
from clgs.reference.general import channels, harmonics, views
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import IDENTITY, SceneTransform
from tests.data.splats.test_gaussians import columns_of, write
from tests.ops.cases.project import camera_at
from tests.ops.cases.splats import stored

LEVEL = 1 / 255
CAMERA = camera_at(60.0, 72, 56)


def picture(columns, camera, antialiased=False, near=NEAR_PLANE, blur=BLUR):
    """The picture (3, H, W) of columns as float64 has it, every splat over every pixel."""
    wide = {name: np.asarray(column, np.float64) for name, column in columns.items()}

    def stack(*names):
        return np.stack([wide[name] for name in names], axis=1)

    mean, scale = stack(*"xyz"), np.exp(stack("scale_0", "scale_1", "scale_2"))
    covariance = views.covariances(scale, stack("rot_0", "rot_1", "rot_2", "rot_3"))
    count = sum(name.startswith("f_rest_") for name in wide) // 3
    rest = [stack(*(f"f_rest_{count * c + i}" for c in range(3))) for i in range(count)]
    sh = np.stack([stack("f_dc_0", "f_dc_1", "f_dc_2"), *rest], axis=1)
    color = harmonics.forward(mean, sh, camera.centre, math.isqrt(count))
    lens, size = (
        views.CameraModel(compensated=antialiased, blur=blur),
        (camera.width, camera.height),
    )
    opacity = 1 / (1 + np.exp(-wide["opacity"]))
    projected, opacity = views.forward(mean, covariance, opacity, camera.pack(near), lens)
    layers = channels.layers(projected, opacity, size, ALPHA_MAX)
    return channels.forward(layers, color, np.zeros(3), size)[0].transpose(2, 0, 1)


def drawn(device, path, camera):
    scene = load_splats(path)
    moved = move_camera(camera, IDENTITY, scene.transform)
    return Renderer(device, scene).render(moved)


@pytest.fixture
def small(rng):
    """Splats that are smaller than a pixel, most of them."""
    gaussians = stored(rng, 300)
    gaussians.log_scale[:] -= 1.5
    return columns_of(gaussians)


@pytest.mark.parametrize("comment", ["made by hand", "SplatRenderMode: mip", "antialiased 1"])
def test_marks_decide_how_splats_are_drawn(device, tmp_path, small, comment):
    path = write(tmp_path / "s.ply", small, [comment])
    wanted = picture(small, CAMERA, antialiased=comment != "made by hand")
    assert np.abs(drawn(device, path, CAMERA) - wanted).max() <= LEVEL
    other = picture(small, CAMERA, antialiased=comment == "made by hand")
    assert np.abs(other - wanted).max() > 20 * LEVEL


@pytest.mark.parametrize("kind", ["antialiased_render_mode_mip", "antialiased_1", "opacity_inf"])
def test_marks_and_opacities_of_one_in_files_of_others(device, shared_data, kind):
    path = shared_data / "cases" / f"{kind}.ply"
    columns = read_ply(path).columns
    assert np.isinf(columns["opacity"]).any() == (kind == "opacity_inf")
    wanted = picture(columns, CAMERA, antialiased=kind != "opacity_inf")
    assert np.abs(drawn(device, path, CAMERA) - wanted).max() <= LEVEL


def test_far_files_of_others_look_as_near_ones(device, shared_data):
    """The middle of double_utm.ply is far away; the camera goes along."""
    far, near = (shared_data / "cases" / f"double_{name}.ply" for name in ("utm", "origin"))
    middles = [
        np.array([np.mean(read_ply(path).columns[name]) for name in "xyz"]) for path in (far, near)
    ]
    place = SceneTransform(tuple((middles[0] - middles[1]).tolist()))
    pictures = drawn(device, far, move_camera(CAMERA, place, IDENTITY)), drawn(device, near, CAMERA)
    assert np.abs(pictures[0] - pictures[1]).max() <= LEVEL
    assert np.abs(pictures[1] - picture(read_ply(near).columns, CAMERA)).max() <= LEVEL


@pytest.mark.parametrize("times", [1e-4, 0.01, 1.0, 1000.0])
def test_scenes_of_any_size_look_the_same(device, tmp_path, rng, times):
    columns = columns_of(stored(rng, 300))
    wanted = picture(columns, CAMERA)
    for name in "xyz":
        columns[name] = columns[name] * np.float32(times)
    for i in range(3):
        columns[f"scale_{i}"] = columns[f"scale_{i}"] + np.float32(np.log(times))
    path = write(tmp_path / "s.ply", columns)
    camera = move_camera(CAMERA, IDENTITY, SceneTransform(scale=times))
    assert np.abs(drawn(device, path, camera) - wanted).max() <= LEVEL


def test_splats_without_thickness(device, tmp_path, rng):
    columns = columns_of(stored(rng, 200))
    flat = {**columns, "scale_2": np.full(200, -np.inf, np.float32)}
    lacking = {name: column for name, column in columns.items() if name != "scale_2"}
    wanted = picture(flat, CAMERA)
    for one in (flat, lacking):
        found = drawn(device, write(tmp_path / "s.ply", one), CAMERA)
        assert np.abs(found - wanted).max() <= LEVEL


def test_filtered_splats_look_as_mip_splatting_draws_them(device, tmp_path, small):
    """It blurs by 0.1 square pixels; with the compensation, 0.3 looks nearly the same."""
    size = [np.exp(small[f"scale_{i}"].astype(np.float64)) for i in range(3)]
    width = np.full(300, 0.02, np.float32)
    wider = [np.sqrt(one**2 + width.astype(np.float64) ** 2) for one in size]
    share = np.prod(size, axis=0) / np.prod(wider, axis=0)
    opacity = share / (1 + np.exp(-small["opacity"].astype(np.float64)))
    fused = small | {f"scale_{i}": np.log(wider[i]) for i in range(3)}
    fused |= {"opacity": np.log(opacity / (1 - opacity))}
    path = write(tmp_path / "s.ply", {**small, "filter_3D": width})
    found = drawn(device, path, CAMERA)
    assert np.abs(found - picture(fused, CAMERA, antialiased=True)).max() <= LEVEL
    meant, classic = picture(fused, CAMERA, True, blur=0.1), picture(fused, CAMERA)
    errors = [np.sqrt(np.mean((one - meant) ** 2)) for one in (found, classic)]
    assert errors[0] < 0.5 * errors[1]


def test_two_formats_of_a_real_scene_look_the_same(device, shared_data):
    """Niantic's programs turn a PLY file's axes (y down) for SPZ (y up); a reader turns none."""
    chunks, spz = (
        load_splats(shared_data / "splats" / f"biker{suffix}")
        for suffix in (".compressed.ply", ".spz")
    )
    turn = np.diag([1.0, -1.0, -1.0])
    assert np.abs(chunks.gaussians.mean @ turn - spz.gaussians.mean).max() < 1e-3
    camera = Camera(np.eye(3), np.array([0.0, 1.6, 4.0]), 150.0, 150.0, 80.0, 60.0, 160, 120)
    turned = replace(camera, rotation=camera.rotation @ turn)
    pictures = Renderer(device, chunks).render(camera), Renderer(device, spz).render(turned)
    assert pictures[0].std() > 0.05
    assert np.sqrt(np.mean((pictures[0] - pictures[1]) ** 2)) < 0.01
