"""The parts of scripts/reproduce.py are the package ``reproduce`` in the folder of scripts."""

import sys
from pathlib import Path

import pytest

from tests.small_scene import write_scene

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
sys.path.insert(0, str(SCRIPTS))

TABLE = """
[scene.balls]
data = "balls"
settings = { voxel = 0.05, start_points = 2000, steps = 60, size_lambda = 1.0 }
protocol = "tiny"

[experiment.main]
kind = "main"
scenes = ["balls"]
seeds = [0, 1]

[experiment.lambda]
kind = "curve"
scenes = ["balls"]
setting = "size_lambda"
values = [0.5, 1.0]

[experiment.taken-away]
kind = "ablation"
scenes = ["balls"]

[experiment.taken-away.variants]
"lambda 0" = { size_lambda = 0.0 }
"""


@pytest.fixture
def table_file(tmp_path):
    """A table of four runs on the tiny scene."""
    path = tmp_path / "table.toml"
    path.write_text(TABLE)
    return path


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """The folder that ``--data`` names."""
    folder = tmp_path_factory.mktemp("data")
    write_scene(folder / "balls")
    return folder


def row(run, psnr=30.0, size=1000, anchors=10, **other):
    """What a run's folder would hold, without training."""
    return {
        "run": run, "settings": {"seed": 0}, "steps": 60, "protocol": "clgs-1", "views": 3,
        "split": "test", "psnr": psnr, "psnr_channel_mean": psnr + 0.1, "ssim": 0.9,
        "bytes": size, "anchors": anchors, "sha256": "0" * 64, "scene_hash": "1" * 64,
        "sections": {"container": 8, "META": 92, "ANCH": 100, "OFFS": 200, "FEAT": 300,
                     "SCAL": 100, "MLPS": 150, "CHNK": 50},
        "seconds": 10.0, "load_seconds": 1.0, "train_seconds": 8.9, "encode_seconds": 0.1,
        "decode_seconds": 0.05, "pictures_per_second": 20.0, "peak_memory_bytes": 2**28,
        "workers": 1, "state": "abc",
        "machine": {"device": {"name": "a device"}, "processor": "a processor"},
        **other,
    }  # fmt: skip
