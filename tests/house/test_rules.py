"""Every rule of the architecture must be able to fail."""

import pytest

from tests.house import rules


@pytest.mark.parametrize(
    ("module", "line", "complaint"),
    [
        ("clgs.ops.mlp", "from clgs.render import rasterise", "ops imports render"),
        ("clgs.scene.camera", "import clgs.train.run.trainer", "scene imports train"),
        ("clgs.files", "from clgs import opencl", "files imports opencl"),
        ("clgs.cli.commands.run", "from clgs.lab.bench import step", "cli imports lab"),
        (
            "clgs.cli.commands.train",
            "def run():\n    from . import main",
            "write the import in full",
        ),
        ("clgs.train.run.trainer", "import pyopencl as cl", "only clgs.opencl imports pyopencl"),
        ("clgs.ops.mlp", "from clgs.scene.scene import Scene", "ops never know"),
        (
            "clgs.reference.mlp",
            "from clgs.errors import DataError",
            "references never import",
        ),
        ("clgs.reference.mlp", "import scipy.ndimage", "references never import scipy"),
    ],
)
def test_bad_imports_are_found(module, line, complaint):
    (found,) = rules.import_complaints(module, line)
    assert complaint in found


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("clgs.ops.mlp", "from clgs.scene.camera import Camera\nimport numpy as np"),
        ("clgs.cli.commands.train", "from clgs.train.run import trainer"),
        ("clgs.opencl.device", "import pyopencl as cl"),
        (
            "clgs.reference.mlp",
            "import math\nimport numpy as np\nfrom clgs.constants import BLUR",
        ),
        ("clgs", "from clgs.train.run import trainer"),
    ],
)
def test_good_imports_pass(module, line):
    assert rules.import_complaints(module, line) == []


def test_imports_in_a_circle_are_found():
    one_way = {
        "clgs.train.run.session": "from clgs.train.step.queue import StepQueue",
        "clgs.train.step.queue": "from clgs.train.step import schedule\nimport clgs.codec.box",
        "clgs.train.helper": "import clgs.train.run.session",
        "clgs.files": "import json",
    }
    assert rules.arrow_complaints(one_way) == []
    back = {"clgs.train.state.checkpoint": "def f():\n    from clgs.train.run import session"}
    through = {"clgs.train.step.look": "import clgs.train.state.checkpoint"}
    assert rules.arrow_complaints({**one_way, **back}) == []
    (found,) = rules.arrow_complaints({**one_way, **back, **through})
    assert "clgs/train" in found
    assert all(part in found for part in ("run", "step", "state"))


def test_long_files_are_found():
    assert rules.length_complaints("x.sh", "a\n" * 400) == []
    (found,) = rules.length_complaints("x.sh", "a\n" * 401)
    assert "401 lines" in found


def test_kernels_are_found_by_name():
    text = """// __kernel void not_this(int x)
__kernel void mlp_forward(__global float *x) {}
__kernel __attribute__((reqd_work_group_size(16, 16, 1))) void mlp_backward(
    __global float *x) {}
__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void blend_rows(__global float *x) {}
__kernel void blend_rows(__global float *x, int of_another_branch) {}
GROUP __kernel void mlp_group(__global float *x) {}
void helper(int x) {}
"""
    assert rules.kernels_in(text) == ["mlp_forward", "mlp_backward", "blend_rows", "mlp_group"]
    stages = ["mlp", "blend"]
    assert rules.kernel_file_complaints("kernels_cl/mlp/forward.cl", "void f() {}", stages)
    (found,) = rules.kernel_file_complaints("kernels_cl/mlp/forward.cl", text, stages)
    assert "several stages" in found
    kernel = "__kernel void blend_rows(__global float *x) {}"
    assert rules.kernel_file_complaints("kernels_cl/mlp/forward.cl", kernel, stages)
    assert not rules.kernel_file_complaints("kernels_cl/blend/forward.cl", kernel, stages)
    (found,) = rules.kernel_file_complaints("kernels_cl/blend/forward.h", kernel, stages)
    assert "a header holds a kernel" in found


def test_fetching_the_kernel_of_another_stage_is_found():
    text = 'kernel = device.kernel("mlp/mlp", "mlp_forward")\n'
    kernels = {"mlp_forward": "mlp"}
    assert rules.fetch_complaints("clgs/ops/mlp.py", text, kernels) == []
    (found,) = rules.fetch_complaints("clgs/ops/blend.py", text, kernels)
    assert found == "clgs/ops/blend.py:1: mlp_forward belongs to the op mlp"
    assert rules.fetch_complaints("clgs/lab/kernels.py", text, kernels) == []


@pytest.mark.parametrize(
    "line",
    [
        "import pickle",
        "from marshal import loads",
        "eval(text)",
        "exec(text)",
        "import os\nos.system('ls')",
        "subprocess.run(command, shell=True)",
        "yaml.load(text)",
        "np.load(path, allow_pickle=True)",
        "np.load(path, allow_pickle=trusted)",
    ],
)
def test_unsafe_code_is_found(line):
    assert len(rules.safety_complaints("x.py", line)) == 1


def test_safe_code_passes():
    text = "subprocess.run([x], shell=False)\nnp.load(p, allow_pickle=False)\nyaml.safe_load(t)\n"
    assert rules.safety_complaints("x.py", text) == []


def test_folders_are_read_from_their_section_only():
    text = "| `a/` |\n## Folders\n| `clgs/` | x |\n| `clgs/ops/` | y |\n## Glossary\n| `b/` |\n"
    assert rules.listed_folders(text) == {"clgs", "clgs/ops"}
