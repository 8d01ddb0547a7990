"""Exported files, opened by two programs of others each, and one of them drawn.

``scripts/checks/splat_programs.sh`` installs the programs; without them the tests are skipped.
"""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from clgs.data.splats.gaussians import load_splats
from clgs.exports.glb import EXTENSION, encode_glb
from clgs.exports.splats.ply import encode_ply
from clgs.exports.splats.sog import encode_sog
from clgs.exports.splats.spz import encode_spz
from clgs.reference.general.views import covariances
from clgs.render.renderer import Renderer
from clgs.scene.gaussians import OrdinaryGaussians
from clgs.scene.scene import SplatScene
from tests.exports.splats.cases import differences, gaussians
from tests.ops.cases.project import camera_at

ROOT = Path(__file__).resolve().parents[3]
PROGRAMS = Path(os.environ.get("CLGS_SPLAT_PROGRAMS", ROOT / "build" / "splat_programs"))
ENCODERS = {".ply": encode_ply, ".spz": encode_spz, ".sog": encode_sog}
TOLERANCE = 2e-5

READ = """
import sys, gsply, numpy
path = sys.argv[1]
readers = {"ply": gsply.plyread, "spz": gsply.read_spz, "sog": gsply.sogread}
found = readers[path[-3:]](path)
sh = numpy.asarray(found.sh0).reshape(-1, 1, 3)
if found.shN is not None:
    sh = numpy.concatenate([sh, numpy.asarray(found.shN).reshape(len(sh), -1, 3)], axis=1)
names = "mean", "log_scale", "rotation", "opacity", "sh"
arrays = found.means, found.scales, found.quats, numpy.ravel(found.opacities), sh
numpy.savez(sys.argv[2], **dict(zip(names, arrays)))
"""


def installed(path: str) -> Path:
    """A file of the programs; skips the test if there is none."""
    if not (PROGRAMS / path).exists():
        pytest.skip(f"{path} is not installed; run scripts/checks/splat_programs.sh")
    return PROGRAMS / path


def run(*words: object) -> str:
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("suffix", ENCODERS)
def test_gsply_reads_the_same(tmp_path, suffix, degree):
    python = installed("venv/bin/python")
    encoded = ENCODERS[suffix](gaussians(degree))
    path = tmp_path / f"scene{suffix}"
    path.write_bytes(encoded.data)
    run(python, "-c", READ, path, tmp_path / "found.npz")
    with np.load(tmp_path / "found.npz") as archive:
        found = OrdinaryGaussians(**{n: archive[n].astype(np.float32) for n in archive.files})
    assert found.degree == degree
    assert max(differences(found, encoded.gaussians).values()) <= TOLERANCE


@pytest.mark.parametrize("suffix", ENCODERS)
def test_splat_transform_reads_the_same_and_it_is_drawn_alike(tmp_path, suffix, device):
    program = installed("node_modules/@playcanvas/splat-transform/bin/cli.mjs")
    encoded = ENCODERS[suffix](gaussians())
    path, stored = tmp_path / f"scene{suffix}", encoded.gaussians
    path.write_bytes(encoded.data)
    run("node", program, path, tmp_path / "again.ply")
    found = load_splats(tmp_path / "again.ply").gaussians
    assert max(differences(found, stored).values()) <= TOLERANCE
    camera = camera_at()
    ours, theirs = (Renderer(device, SplatScene(one)).render(camera) for one in (stored, found))
    assert np.abs(ours - theirs).max() <= 1e-3


def test_three_and_the_validator_open_glb(tmp_path):
    installed("node_modules/three/package.json")
    installed("node_modules/gltf-validator/package.json")
    before = gaussians()
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    path = tmp_path / "scene.glb"
    path.write_bytes(encode_glb(before, turn=turn).data)
    found = json.loads(run("node", Path(__file__).with_name("open_glb.mjs"), PROGRAMS, path))
    three = found["three"]
    assert np.allclose(np.reshape(three["matrix"], (4, 4)).T[:3, :3], turn)
    assert [f"sphericalHarmonics{degree}" for degree in (1, 2, 3)] == three["names"][3:]
    assert np.array_equal(np.float32(three["position"]).reshape(-1, 3), before.mean)
    scale, rotation = np.exp(before.log_scale.astype(float)), before.rotation.astype(float)
    whole = covariances(scale, rotation)[:, *np.triu_indices(3)]
    assert np.allclose(np.reshape(three["covariance"], (-1, 6)), whole, rtol=1e-4, atol=1e-7)
    color = 255 * (0.5 + 0.28209479 * before.sh[:, 0])
    shown = np.reshape(three["color"], (-1, 4))[:, :3]
    assert np.abs(shown - np.clip(color, 0, 255)).max() <= 0.51
    assert not [one for one in found["validator"]["messages"] if not expected(one)]


def expected(message: dict) -> bool:
    """What the validator says of any file with the extension, which it does not know."""
    names = message["code"] == "MESH_PRIMITIVE_INVALID_ATTRIBUTE"
    if names:
        return f"/{EXTENSION}:" in message["pointer"]
    return message["severity"] > 1  # hints and information
