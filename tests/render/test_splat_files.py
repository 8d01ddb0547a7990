"""Files of splats as other programs write them, drawn as they are meant: against float64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.constants import ALPHA_CUT, ALPHA_MAX, BLUR, NEAR_PLANE, TRANSMITTANCE_STOP
from clgs.data.origin import move_camera
from clgs.data.splats.gaussians import load_splats
from clgs.data.splats.ply import PlyTable, pack_ply, read_ply
from clgs.reference import project
from clgs.reference.general.splats import basis
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import IDENTITY, SceneTransform
from tests.data.splats.test_gaussians import columns_of
from tests.ops.cases.project import camera_at
from tests.ops.cases.splats import stored

LEVEL = 1 / 255
CAMERA = camera_at(60.0, 72, 56)


def picture(columns, camera, antialiased=False, near=NEAR_PLANE, blur=BLUR):
    """The picture (3, H, W) of columns as float64 has it, splat after splat in every pixel."""
    wide = {name: np.asarray(column, np.float64) for name, column in columns.items()}

    def stack(*names):
        return np.stack([wide[name] for name in names], axis=1)

    mean, scale = stack(*"xyz"), np.exp(stack("scale_0", "scale_1", "scale_2"))
    rotation = stack("rot_0", "rot_1", "rot_2", "rot_3")
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    view = project.unpack(camera.pack(near))
    view = replace(view, rotation=camera.rotation, translation=camera.translation)
    count = sum(name.startswith("f_rest_") for name in wide) // 3
    rest = [stack(*(f"f_rest_{count * c + i}" for c in range(3))) for i in range(count)]
    sh = np.stack([stack("f_dc_0", "f_dc_1", "f_dc_2"), *rest], axis=1)
    away = mean - camera.centre
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    color = np.maximum(0.5 + np.einsum("nci,nc->ni", sh, basis(away, 1 + count)), 0)
    opacity = 1 / (1 + np.exp(-wide["opacity"]))
    sharp = project.covariance2d(view, mean, scale, rotation) - BLUR * np.eye(2)
    blurred = sharp + blur * np.eye(2)
    if antialiased:
        opacity = opacity * np.sqrt(np.linalg.det(sharp) / np.linalg.det(blurred))
    inverse = np.linalg.inv(blurred)
    point = mean @ view.rotation.T + view.translation
    middle = view.focal * point[:, :2] / point[:, 2:] + view.centre2d
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    image, left = np.zeros((3, *x.shape)), np.ones_like(x)
    for n in np.argsort(point[:, 2], kind="stable"):
        if point[n, 2] <= near:
            continue
        dx, dy = x - middle[n, 0], y - middle[n, 1]
        (a, b), (_, c) = inverse[n]
        alpha = opacity[n] * np.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
        alpha = np.where(alpha < ALPHA_CUT, 0, np.minimum(alpha, ALPHA_MAX))
        alpha = np.where(left * (1 - alpha) < TRANSMITTANCE_STOP, 0, alpha)
        image += color[n][:, None, None] * alpha * left
        left *= 1 - alpha
    return image


def drawn(device, path, camera):
    scene = load_splats(path)
    moved = move_camera(camera, IDENTITY, scene.transform)
    return Renderer(device, scene).render(moved)


def write(path, columns, comments=()):
    path.write_bytes(pack_ply(PlyTable(columns, list(comments))))
    return path


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


@pytest.mark.parametrize("kind", ["antialiased_render_mode_mip", "antialiased_1"])
def test_marked_files_of_others(device, shared_data, kind):
    path = shared_data / "cases" / f"{kind}.ply"
    wanted = picture(read_ply(path).columns, CAMERA, antialiased=True)
    assert np.abs(drawn(device, path, CAMERA) - wanted).max() <= LEVEL


def test_opacities_of_one(device, shared_data):
    path = shared_data / "cases" / "opacity_inf.ply"
    columns = read_ply(path).columns
    assert np.isinf(columns["opacity"]).any()
    assert np.abs(drawn(device, path, CAMERA) - picture(columns, CAMERA)).max() <= LEVEL


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
