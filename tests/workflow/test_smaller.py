"""Parts of a scene: boxes, spheres, what masks show, what several photos show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clgs.codec.scene_decoder import decode, decode_box
from clgs.codec.scene_encoder import encode
from clgs.codec.sections import BytesSource
from clgs.data.dataset import load_dataset
from clgs.data.origin import repose
from clgs.data.splats.anchors import save_scaffold
from clgs.errors import DataError, UsageError
from clgs.scene.anchors import QuantizationScales
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.region import Box, Sphere
from clgs.scene.scene import QuantizedScene, SceneTransform
from clgs.scene.storage import save_scene
from clgs.workflow.options import ViewOptions
from clgs.workflow.smaller import crop
from tests.codec.scenes import random_scene
from tests.data.folders import write_transforms
from tests.small_scene import write_scene

PATH = Path("scene.clgs")
BOX = Box((-0.5, -1.0, -1.0), (0.7, 1.0, 0.4))


@pytest.fixture
def scene(rng) -> QuantizedScene:
    """Small opaque blobs of one color, in a cube of edge 2 around the origin."""
    made = random_scene(rng, 900)
    mlps = Mlps(np.zeros(MLP_SIZE, np.float32))
    mlps.head("opacity")["output_bias"][...] = 2.0
    mlps.head("covariance")["output_bias"][3::7] = 1.0  # w of the rotations
    anchors = replace(made.anchors, scaling=np.full_like(made.anchors.scaling, -32))
    scales = QuantizationScales(position=9.0, offset=4.0, feature=1.0, scaling=8.0)
    return replace(made, anchors=anchors, mlps=mlps, scales=scales)


def test_a_box_is_that_of_decode(scene):
    scene = replace(scene, transform=SceneTransform((3.0, -2.0, 1.0), 0.5))
    box = Box((2.0, -3.0, 0.0), (4.2, -1.0, 2.0))
    found = crop(PATH, scene, encode, ViewOptions(), regions=[box])
    assert found.psnr is None
    assert 0 < len(found.scene.anchors) < len(scene.anchors)
    assert len(found.data) < len(encode(scene))
    assert found.data == encode(decode_box(BytesSource(encode(scene)), box))
    assert decode(found.data).transform == scene.transform


def test_all_regions_hold(scene):
    sphere = Sphere((0.2, 0.0, 0.0), 0.6)
    found = crop(PATH, scene, encode, ViewOptions(), regions=[BOX, sphere]).scene
    place = scene.anchors.position / 9.0
    kept = [
        -0.5 <= x < 0.7 and z < 0.4 and (x - 0.2) ** 2 + y**2 + z**2 <= 0.36 for x, y, z in place
    ]
    assert np.array_equal(found.anchors.position, scene.anchors.position[kept])
    assert np.array_equal(found.anchors.feature, scene.anchors.feature[kept])
    assert np.array_equal(found.mlps.flat, scene.mlps.flat)


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_spheres_that_are_none(radius):
    with pytest.raises(UsageError, match=r"^sphere: .* give a centre and a radius above 0"):
        Sphere((0.0, 0.0, 0.0), radius)


def test_a_sphere_of_any_size_holds_what_is_near():
    far = Sphere((1e300, 0.0, 0.0), 1e300)
    points = np.array([[1e299, 0.0, 0.0], [1.0, 1.0, 1.0], [-1e299, 0.0, 0.0], [1e300, 1e300, 0.0]])
    assert far.holds(points).tolist() == [True, True, False, True]


def test_nothing_left(scene):
    with pytest.raises(UsageError, match=r"^scene\.clgs: nothing would be left"):
        crop(PATH, scene, encode, ViewOptions(), regions=[Sphere((9.0, 9.0, 9.0), 1.0)])


def test_masks_keep_the_object(scene, tmp_path, open_device):
    data = write_scene(tmp_path / "data", size=64)
    views = ViewOptions(data=data, device=open_device("cpu").name)
    found = crop(PATH, scene, encode, views, masked=True)
    dataset = repose(load_dataset(data), scene.transform)
    place, shown = scene.anchors.position / 9.0, []
    for view in dataset.train:
        camera, alpha = view.camera, view.photo.pixels().alpha
        local = place @ camera.rotation.T + camera.translation
        column = (local[:, 0] / local[:, 2] * camera.fx + camera.cx).astype(int)
        row = (local[:, 1] / local[:, 2] * camera.fy + camera.cy).astype(int)
        framed = np.pad(alpha, 9)  # a corner of the cube may be outside of the photo
        shown.append(framed[row + 9, column + 9] >= 128)
    share = np.mean(shown, axis=0)
    kept = {tuple(row) for row in found.scene.anchors.position.tolist()}
    is_kept = np.array([tuple(row) in kept for row in scene.anchors.position.tolist()])
    assert is_kept[share < 0.1].mean() < 0.02
    assert is_kept[share == 1].mean() > 0.9
    assert (share < 0.1).sum() > 40
    assert (share == 1).sum() > 20
    before, after = found.psnr
    assert after > before + 3  # the photos show black around the balls
    assert found.views == 3


@pytest.mark.slow
def test_what_few_photos_show_goes(scene, tmp_path, open_device):
    data = write_scene(tmp_path / "data", size=64)
    views = ViewOptions(data=data, device=open_device("cpu").name)
    counts = [
        len(crop(PATH, scene, encode, views, least_views=number).scene.anchors)
        for number in (1, 4, 8)
    ]
    assert len(scene.anchors) >= counts[0] > counts[1] > counts[2] > 0


def test_photos_without_masks_are_refused(scene, tmp_path, open_device):
    write_transforms(tmp_path / "data", 6)
    views = ViewOptions(data=tmp_path / "data", device=open_device("cpu").name)
    with pytest.raises(DataError, match=r"no training photo has a mask; leave out --object"):
        crop(PATH, scene, encode, views, masked=True)


@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        ("crop s.clgs -o x.clgs", 2, "nothing is asked for; give --box, --sphere, --object or"),
        ("crop s.clgs -o x.npz --seen 2", 2, "x.npz: the output is a .clgs file; name it so"),
        ("crop s.clgs -o s.clgs --seen 2", 2, "s.clgs: is read by this command"),
        ("crop s.npz -o s.clgs --seen 2", 2, "s.clgs: exists already; add --overwrite or choose"),
        ("crop s.clgs -o x.clgs --seen 0", 2, "--seen: 0 is not a whole number from 1 to"),
        ("crop s.clgs -o x.clgs --seen 2", 2, "the photos are not known; name their data set"),
        ("crop s.clgs -o x.clgs --object", 2, "the photos are not known; name their data set"),
        ("crop s.clgs -o x.clgs --box 0,0,0,1,1", 2, "--box: 0,0,0,1,1: 6 numbers are needed"),
        ("crop s.clgs -o x.clgs --sphere 0,0,0", 2, "--sphere: 0,0,0: 4 numbers are needed"),
        ("crop s.clgs -o x.clgs --sphere -1,0,0,-2", 2, "sphere: -1,0,0,-2 is none; give a"),
        ("crop s.clgs -o x.clgs --sphere 90,0,0,1", 2, "s.clgs: nothing would be left"),
        ("crop s.clgs -o x.clgs --sphere 0,0,0,1 --downscale 2", 2, "--downscale: no photos are"),
        ("crop s.clgs -o x.clgs --seen 2 --level much", 2, "level: "),
        ("crop folder -o x.clgs --sphere 0,0,0,1", 3, "folder: holds no scene.npz; name a run"),
        ("crop s.ply -o x.clgs --sphere 0,0,0,1", 3, "s.ply: "),
    ],
)
def test_refusals_are_one_line(scene, tmp_path, monkeypatch, refusal, command, code, said):
    monkeypatch.chdir(tmp_path)
    Path("s.clgs").write_bytes(encode(scene))
    save_scene("s.npz", scene)
    save_scaffold(Path("s.ply"), scene)
    Path("folder").mkdir()
    before = sorted(tmp_path.iterdir())
    assert refusal(code, *command.split()).startswith(said)
    assert sorted(tmp_path.iterdir()) == before


def test_the_command_tells_bytes_and_psnr(scene, tmp_path, output_of, refusal, open_device):
    data, part = write_scene(tmp_path / "data"), tmp_path / "part.clgs"
    run = tmp_path / "run"
    run.mkdir()
    save_scene(run / "scene.npz", scene)
    whole = run / "scene.clgs"
    whole.write_bytes(encode(scene))
    device = ["--data", str(data), "--device", open_device("cpu").name]
    lines = output_of("crop", run, "-o", part, "--object", "--seen", "2", *device).splitlines()
    assert lines[0].startswith(f"{run}: {whole.stat().st_size:,} bytes, {len(scene.anchors)} anch")
    assert lines[1].startswith(f"{part}: {part.stat().st_size:,} bytes, ")
    assert lines[2].startswith("PSNR on 3 photos: ")
    assert 0 < len(decode(part.read_bytes()).anchors) < len(scene.anchors)
    before = whole.read_bytes()
    words = ["crop", str(run), "-o", str(whole), "--seen", "2", "--overwrite", *device]
    assert refusal(2, *words).startswith(f"{whole}: is read by this command")
    assert whole.read_bytes() == before
