"""nerfstudio's trainer runs ``clgs-splatfacto`` on a machine without CUDA.

How to install it: docs/reference/rasterization.md.
"""

import json
import os
import random
import subprocess
import sys
import tomllib
from copy import deepcopy
from importlib import import_module
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install clgs[torch]")
pytest.importorskip("gsplat", reason="gsplat is not installed: pip install gsplat")
pytest.importorskip(
    "nerfstudio.configs.method_configs",
    reason="nerfstudio is not installed: pip install nerfstudio",
    exc_type=ImportError,
)

from nerfstudio.data.dataparsers.blender_dataparser import BlenderDataParserConfig  # noqa: E402
from nerfstudio.models import splatfacto  # noqa: E402
from torchmetrics.image import lpip  # noqa: E402

from tests.small_scene import write_scene  # noqa: E402

PROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"


def entry_point():
    """What pyproject.toml names."""
    groups = tomllib.loads(PROJECT.read_text())["project"]["entry-points"]
    module, name = groups["nerfstudio.method_configs"]["clgs-splatfacto"].split(":")
    return getattr(import_module(module), name)


def test_the_trainer_learns(tmp_path, monkeypatch):
    # its network's weights would be downloaded
    monkeypatch.setattr(lpip, "LearnedPerceptualImagePatchSimilarity", torch.nn.Identity)
    folder, usual = write_scene(tmp_path / "balls", train=4, test=1, size=24), torch.Tensor.cuda
    held_out = json.loads((folder / "transforms_test.json").read_text())
    (folder / "transforms_val.json").write_text(json.dumps(held_out))
    config = deepcopy(entry_point().config)
    config.pipeline.datamanager.dataparser = BlenderDataParserConfig(data=folder)
    config.pipeline.model.num_random = 300
    config.output_dir, config.machine.device_type = tmp_path / "out", "cpu"
    config.vis, config.max_num_iterations = "", 6
    random.seed(config.machine.seed)  # as ns-train does: some random points are out of sight
    torch.manual_seed(config.machine.seed)
    trainer = config.setup()
    trainer.setup()
    model, theirs = trainer.pipeline.model, splatfacto.rasterization
    before = {name: one.detach().clone() for name, one in model.gauss_params.items()}
    trainer.train()
    for name in ("means", "scales", "opacities", "features_dc"):
        assert not torch.equal(before[name], model.gauss_params[name]), name
    model.eval()
    picture = model.get_outputs(trainer.pipeline.datamanager.train_dataset.cameras[:1])["rgb"]
    assert picture.shape == (24, 24, 3)
    assert picture.std() > 0.01
    assert (splatfacto.rasterization, torch.Tensor.cuda) == (theirs, usual)
    assert list((tmp_path / "out").rglob("step-*.ckpt"))


def test_the_method_is_found_if_its_module_is_imported_first(tmp_path):
    code = """import clgs.torch.splatfacto as ours
assert ours.METHOD.config.method_name == "clgs-splatfacto"
from nerfstudio.configs.method_configs import all_methods
assert all_methods["clgs-splatfacto"].pipeline.model._target is ours.ClgsSplatfactoModel
assert not hasattr(ours, "METHODS")
"""
    named = {"NERFSTUDIO_METHOD_CONFIGS": "clgs-splatfacto=clgs.torch.splatfacto:METHOD"}
    subprocess.run([sys.executable, "-c", code], env=os.environ | named, cwd=tmp_path, check=True)


def test_an_older_gsplat_is_refused(monkeypatch):
    method = entry_point()
    monkeypatch.setattr("gsplat.__version__", "1.4.0")
    with pytest.raises(ImportError, match=r"gsplat 1\.4\.0 is too old"):
        method.config.pipeline.model.setup(scene_box=None, num_train_data=1)
