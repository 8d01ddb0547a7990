"""Start points from files of every format, whole, damaged and hostile."""

import json
import shutil
import struct

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from clgs.data import points
from clgs.data.dataset import load_dataset
from clgs.data.points import SUFFIXES, filled, read_points
from clgs.errors import DataError
from tests.data.folders import move_cameras, save_json
from tests.small_scene import write_scene

SAMPLES = 500


def box():
    """A box of 2 x 4 x 6 world units around (1, 2, 3)."""
    mesh = trimesh.creation.box(extents=(2, 4, 6))
    mesh.apply_translation((1, 2, 3))
    return mesh


def read(path, kind="blender", seed=0):
    return read_points(path, SAMPLES, kind, seed)


def write(path, geometry):
    geometry.export(path)
    return path


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".off", ".glb"])
def test_surfaces_are_sampled_evenly(tmp_path, suffix):
    points = read(write(tmp_path / f"box{suffix}", box()))
    if suffix == ".glb":  # written without a turn, read with one
        points = points @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]).T
    assert (points.shape, points.dtype) == ((SAMPLES, 3), np.float64)
    inside = np.abs(points - (1, 2, 3)) / (1, 2, 3)
    assert np.allclose(inside.max(axis=1), 1, atol=1e-6), "all lie on a face"
    on_x = np.isclose(inside[:, 0], 1).mean()
    assert on_x == pytest.approx(24 / 44, abs=0.1)  # the faces of 4 x 6 have 48 of 88 units


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".xyz", ".obj"])
def test_every_point_of_a_cloud_is_taken(tmp_path, rng, suffix):
    cloud = rng.normal(size=(50, 3))
    path = tmp_path / f"cloud{suffix}"
    if suffix in (".obj", ".xyz"):
        start = "v " if suffix == ".obj" else ""
        path.write_text("".join(f"{start}{x} {y} {z}\n" for x, y, z in cloud))
    else:
        trimesh.PointCloud(cloud).export(path)
    points = read(path, "colmap")
    wanted = cloud * (1, -1, -1) if suffix == ".glb" else cloud
    assert points == pytest.approx(wanted, abs=1e-6)


def test_points_are_added_between_near_ones_and_not_across_gaps(rng):
    near = rng.uniform(0, 1, (400, 3)) * (1, 1, 0)
    both = np.concatenate([near, near + np.array([0.0, 0.0, 10.0])])
    more = filled(both, 2000, 0)
    assert len(more) == 2000
    assert {tuple(point) for point in both} <= {tuple(point) for point in more}
    assert np.isin(more[:, 2], (0, 10)).all()
    assert len(np.unique(more, axis=0)) == 2000
    assert cKDTree(both).query(more)[0].max() < 0.2
    np.testing.assert_array_equal(filled(both, 2000, 0), more)
    assert not np.array_equal(filled(both, 2000, 1), more)


def test_nothing_is_added_to_enough_points_to_few_or_to_one_place(rng):
    cloud = rng.normal(size=(50, 3))
    assert filled(cloud, 50, 0) is cloud
    assert filled(cloud[:3], 50, 0).shape == (3, 3)
    assert filled(np.zeros((50, 3)), 100, 0).shape == (1, 3)
    broken = np.where(np.arange(50)[:, None] == 7, np.nan, cloud)
    assert filled(broken, 100, 0) is broken


def test_points_that_are_there_twice_are_filled_up_as_if_they_were_once(rng):
    cloud = rng.normal(size=(100, 3))
    np.testing.assert_array_equal(filled(cloud.repeat(3, axis=0), 301, 0), filled(cloud, 301, 0))
    line = filled(np.linspace(0, 1, 100)[:, None] * (1, 2, 3), 300, 0)
    assert len(np.unique(line, axis=0)) == len(line) > 190


def test_the_same_seed_gives_the_same_points(tmp_path):
    path = write(tmp_path / "box.stl", box())
    assert np.array_equal(read(path, seed=3), read(path, seed=3))
    assert not np.array_equal(read(path, seed=3), read(path, seed=4))


def test_meshes_and_clouds_of_a_scene_stand_where_they_are_put(tmp_path):
    scene = trimesh.Scene()
    move = trimesh.transformations.translation_matrix((100, 0, 0))
    scene.add_geometry(trimesh.creation.icosphere(radius=1), transform=move)
    scene.add_geometry(trimesh.PointCloud([[0, 0, 50.0]]))
    scene.add_geometry(trimesh.load_path([[[0, 0, 0], [0, 7, 0]]]))
    points = read(write(tmp_path / "scene.glb", scene))
    assert len(points) == SAMPLES + 1
    far = np.linalg.norm(points - (100, 0, 0), axis=1)
    assert (far < 1 + 1e-5).sum() == SAMPLES
    assert (points == (0, -50, 0)).all(axis=1).sum() == 1  # glTF's z is the capture's -y


def test_faces_that_are_no_triangles_of_any_size_are_left_out(tmp_path):
    mesh = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [np.nan, 0, 0], [2, 2, 2]],
        [[0, 1, 2], [0, 1, 3], [4, 4, 4]],
        process=False,
    )
    points = read(write(tmp_path / "some.ply", mesh))
    assert len(points) == SAMPLES
    assert (points[:, 2] == 0).all()


def glb(header, body=b""):
    text = json.dumps({"asset": {"version": "2.0"}, **header}).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if body:
        chunks += struct.pack("<I4s", len(body), b"BIN\0") + body
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


VERTEX = "element vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
PLY = "ply\nformat {} 1.0\n"
ACCESSOR = {"count": 10**12, "type": "VEC3", "componentType": 5126}
POINTS = {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 0}]}]}
OUTSIDE = {"buffers": [{"uri": "/etc/hostname", "byteLength": 4}]}


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("empty.ply", b"", "is empty; name a point cloud"),
        ("noise.ply", bytes(range(256)), "is damaged"),
        ("noise.obj", bytes(range(256)), ""),
        ("noise.glb", bytes(range(256)), "is damaged (no GLB header)"),
        ("noise.stl", bytes(range(256)), "is damaged"),
        ("noise.off", bytes(range(256)), "is damaged"),
        ("noise.xyz", b"\xff\xfe" * 100, ""),
        ("cloud.pcd", b"x", "has no known format by its name; convert it to .ply"),
        ("cloud", b"x", "has no known format by its name"),
        ("huge.ply", (PLY + VERTEX).format("ascii", 10**15).encode() + b"1 2 3\n", "promises 1"),
        (
            "cut.ply",
            (PLY + VERTEX).format("binary_little_endian", 10**15).encode() + b"\0" * 24,
            "",
        ),
        ("none.ply", (PLY + VERTEX).format("binary_little_endian", 0).encode(), ""),
        ("header.ply", b"ply\nformat ascii 1.0\n", ""),
        ("empty.obj", b"# nothing\n", ""),
        ("far.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 99999999\n", ""),
        ("cut.stl", b"\0" * 80 + struct.pack("<I", 2**31) + b"\0" * 50, ""),
        ("flat.stl", b"\0" * 80 + struct.pack("<I", 1) + b"\0" * 50, "neither points nor surfaces"),
        ("many.glb", glb({"accessors": [ACCESSOR], "bufferViews": [], **POINTS}), "promises"),
        (
            "deep.glb",
            b"glTF" + struct.pack("<III", 2, 100_020, 100_000) + b"JSON" + b"[" * 10**5,
            "",
        ),
        ("outside.glb", glb({**OUTSIDE, **POINTS}), ""),
        ("none.glb", glb({}), ""),
    ],
)
def test_a_damaged_file_is_one_line(tmp_path, name, content, said):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(DataError) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert said in message
    assert "\n" not in message


def test_a_file_that_is_none_is_one_line(tmp_path):
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(DataError, match=r"folder\.ply: is no regular file"):
        read(tmp_path / "folder.ply")
    with pytest.raises(DataError, match=r"none\.ply: no such file"):
        read(tmp_path / "none.ply")


def test_large_files_and_scenes_are_refused(tmp_path, monkeypatch):
    path = write(tmp_path / "box.obj", box())
    monkeypatch.setattr(points, "MAX_ELEMENTS", 19)
    with pytest.raises(DataError, match=r"box\.obj: .*more than 19 vertices and faces"):
        read(path)
    monkeypatch.setattr(points, "MAX_BYTES", 100)
    with pytest.raises(DataError, match=r"box\.obj: has more than 0 MiB; thin it out"):
        read(path)


def test_every_suffix_is_one_that_trimesh_knows():
    assert {suffix[1:] for suffix in SUFFIXES} <= set(trimesh.available_formats())


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("balls"), train=4, test=1)


def test_a_data_set_starts_from_the_file(data, tmp_path):
    path = write(tmp_path / "ball.ply", trimesh.creation.icosphere(radius=0.6))
    dataset = load_dataset(data, points_file=path, point_samples=SAMPLES)
    assert dataset.points.shape == (SAMPLES, 3)
    assert dataset.points.dtype == np.float32
    assert dataset.points_file == str(path)
    assert np.linalg.norm(dataset.points, axis=1).max() < 0.6 + 1e-5


def test_points_move_with_the_data_set(data, tmp_path):
    """The world of a transforms.json is scaled and recentred, and the points with it."""
    folder = tmp_path / "moved"
    shutil.copytree(data / "train", folder / "train")
    text = json.loads((data / "transforms_train.json").read_text())
    for frame in text["frames"]:
        frame["file_path"] += ".png"
    save_json(folder, text)
    move_cameras(folder / "transforms.json", lambda centre: 10 * centre + 5)
    world = np.array([[5, 5, 5], [11, 5, 5], [5, 12, 5], [5, 5, 13.0]])
    path = write(tmp_path / "cloud.ply", trimesh.PointCloud(world))
    dataset = load_dataset(folder, points_file=path, point_samples=SAMPLES)
    assert dataset.kind == "transforms"
    assert dataset.transform.scale != 1
    assert dataset.transform.to_world(dataset.points.astype(float)) == pytest.approx(
        world, abs=1e-4
    )


def test_points_far_from_all_cameras_are_refused(data, tmp_path):
    path = write(tmp_path / "far.ply", trimesh.PointCloud(np.eye(3) * 1e6))
    with pytest.raises(DataError, match=r"far\.ply: only 0 of its 3 points lie near the cameras"):
        load_dataset(data, points_file=path)
