"""Cameras as a GLB file: read back by trimesh, and by hand from the header and the JSON."""

import io
import json
import struct
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from clgs.cli import main as cli
from clgs.data.dataset import load_dataset
from clgs.data.points import read_points
from clgs.exports.glb import CAMERA_COLORS, FRUSTUM_DEPTH, cameras_glb
from clgs.scene.scene import SceneTransform
from tests.small_scene import write_scene

CLOUD = np.array([[0.25, 0, 0], [0, 0.5, 0], [0, 0, 0.75], [0.1, 0.2, 0.3]], np.float32)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("balls"), train=5, test=2)


@pytest.fixture(scope="module")
def dataset(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("clouds") / "cloud.ply"
    trimesh.PointCloud(CLOUD).export(path)
    return load_dataset(data, load_images=False, points_file=path, point_samples=10)


def poses(data):
    """Camera-to-world matrices (4, 4) of OpenGL by "split/name", straight from the JSON files."""
    found = {}
    for split in ("train", "test"):
        frames = json.loads((data / f"transforms_{split}.json").read_text())["frames"]
        for frame in frames:
            name = frame["file_path"].removeprefix("./")
            found[f"{split}/{name}.png"] = np.array(frame["transform_matrix"])
    return found


def parse(data):
    """(JSON, binary) of a GLB file, by the specification: 12 bytes, then chunks."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert (kind, size % 4) == (b"JSON", 0)
    document = json.loads(data[20 : 20 + size])
    body_size, body_kind = struct.unpack_from("<I4s", data, 20 + size)
    assert body_kind == b"BIN\0"
    assert 28 + size + body_size == length
    assert document["asset"]["version"] == "2.0"
    return document, data[28 + size :]


def positions(document, body, mesh):
    """Vertices (N, 3) and mode of the only primitive of a mesh."""
    (primitive,) = document["meshes"][mesh]["primitives"]
    accessor = document["accessors"][primitive["attributes"]["POSITION"]]
    assert (accessor["componentType"], accessor["type"]) == (5126, "VEC3")
    view = document["bufferViews"][accessor["bufferView"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    values = np.frombuffer(body, "<f4", 3 * accessor["count"], start).reshape(-1, 3)
    assert np.allclose(values.min(axis=0), accessor["min"])
    return values, primitive["mode"]


def test_points_and_cameras_stand_in_the_captures_world(data, dataset):
    document, body = parse(cameras_glb(dataset))
    nodes = {node["name"]: node for node in document["nodes"]}
    points, mode = positions(document, body, nodes["points"]["mesh"])
    assert mode == 0
    # z up to y up: (x, y, z) is written as (x, z, -y)
    assert np.allclose(points, CLOUD[:, [0, 2, 1]] * (1, 1, -1))
    expected = poses(data)
    assert set(expected) == {name for name in nodes if "/" in name}
    for name, pose in expected.items():
        matrix = np.array(nodes[name]["matrix"]).reshape(4, 4).T  # glTF stores columns
        centre = pose[:3, 3]
        assert np.allclose(matrix[:3, 3], [centre[0], centre[2], -centre[1]])
        forward, up = -pose[:3, 2], pose[:3, 1]
        assert np.allclose(matrix[:3, 2], [forward[0], forward[2], -forward[1]])
        assert np.allclose(matrix[:3, 1], [-up[0], -up[2], up[1]])
        corners, mode = positions(document, body, nodes[name]["mesh"])
        assert mode == 1
        assert len(corners) == 16, "eight edges"
        depth = FRUSTUM_DEPTH * dataset.radius
        assert corners[:, 2].max() == pytest.approx(depth)
        assert corners[:, 0].max() == pytest.approx(depth * np.tan(0.4))  # half of ANGLE


def test_trimesh_reads_it_back(dataset):
    scene = trimesh.load_scene(io.BytesIO(cameras_glb(dataset)), file_type="glb")
    kinds = {name: type(one).__name__ for name, one in scene.geometry.items()}
    assert kinds.pop("points") == "PointCloud"
    assert len(kinds) == 7
    assert set(kinds.values()) == {"Path3D"}


def test_training_cameras_are_blue_and_held_out_ones_orange(dataset):
    document, body = parse(cameras_glb(dataset))
    for node in document["nodes"]:
        if "/" not in node["name"]:
            continue
        (primitive,) = document["meshes"][node["mesh"]]["primitives"]
        accessor = document["accessors"][primitive["attributes"]["COLOR_0"]]
        start = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
        assert tuple(body[start : start + 4]) == CAMERA_COLORS[node["name"].split("/")[0]]


def test_lengths_are_those_of_the_world_not_of_the_scene(dataset):
    """The same file, except for rounding, in all units of training."""
    scale, centre = 0.125, np.array([2.0, 0.5, -1.0])

    def move(view):
        moved = scale * (view.camera.rotation @ centre + view.camera.translation)
        return replace(view, camera=replace(view.camera, translation=moved))

    other = replace(
        dataset,
        train=[move(view) for view in dataset.train],
        test=[move(view) for view in dataset.test],
        points=((dataset.points - centre) * scale).astype(np.float32),
        transform=SceneTransform(tuple(centre), scale),
        radius=dataset.radius * scale,
    )
    first, second = (parse(cameras_glb(one)) for one in (dataset, other))
    for one, two in zip(first[0]["nodes"], second[0]["nodes"], strict=True):
        assert one["name"] == two["name"]
        assert np.allclose(one.get("matrix", 0), two.get("matrix", 0), atol=1e-6)
        if "mesh" in one:
            mine, theirs = positions(*first, one["mesh"])[0], positions(*second, two["mesh"])[0]
            assert np.allclose(mine, theirs, atol=1e-6)


@pytest.mark.parametrize("kind", ["blender", "transforms", "colmap"])
def test_training_starts_from_the_exported_points(dataset, tmp_path, kind):
    path = tmp_path / "cameras.glb"
    path.write_bytes(cameras_glb(replace(dataset, kind=kind)))
    assert read_points(path, 10, kind, 0) == pytest.approx(CLOUD, abs=1e-6)


@pytest.mark.slow
def test_it_needs_no_other_library(data, tmp_path):
    """Trimesh takes networkx if it is there; it is not among the package's dependencies."""
    code = """
import sys
sys.modules["networkx"] = None
from clgs.cli import main as cli
sys.exit(cli.main(["export", sys.argv[1], "-o", sys.argv[2]]))
"""
    command = [sys.executable, "-c", code, str(data), str(tmp_path / "cameras.glb")]
    subprocess.run(command, check=True)
    assert (tmp_path / "cameras.glb").is_file()


def test_the_command_writes_the_file(data, tmp_path, output_of):
    output = tmp_path / "cameras.glb"
    shown = output_of("export", data, "-o", output)
    assert shown == f"{output}: 0 points, 7 cameras, {output.stat().st_size:,} bytes\n"
    document, _ = parse(output.read_bytes())
    assert {node["name"] for node in document["nodes"] if "mesh" in node} == set(poses(data))


@pytest.mark.parametrize(
    ("source", "output", "code", "said"),
    [
        (
            "",
            "cameras.gltf",
            2,
            "cameras.gltf: nothing is written by this suffix; take one of .glb",
        ),
        ("", "none/cameras.glb", 2, "there is no folder"),
        ("train", "cameras.glb", 3, "train: is a part of a data set; name the whole of it"),
        ("none", "cameras.glb", 3, "none: no such folder"),
    ],
)
def test_what_cannot_be_exported_is_one_line(data, tmp_path, refusal, source, output, code, said):
    assert said in refusal(code, "export", data / source, "-o", tmp_path / output)
    assert not list(tmp_path.iterdir())


def test_the_command_trains_from_a_mesh(data, tmp_path, output_of, refusal):
    mesh = tmp_path / "ball.stl"
    trimesh.creation.icosphere(radius=0.6).export(mesh)
    run = tmp_path / "run"
    command = ["train", str(data), "-o", str(run), "--steps", "3", "--points", str(mesh)]
    command += ["--point-samples", "300", "--voxel", "0.01"]
    assert cli.main(command) == 0
    assert f'points = "{mesh}"' in (run / "config.toml").read_text()
    with np.load(run / "scene.npz") as scene:
        assert 250 < len(scene["position"]) <= 300
    assert "is finished already" in output_of(*command, "--resume")
    mesh.write_bytes(b"")
    assert f"{mesh}: is empty" in refusal(3, *command, "--resume")
