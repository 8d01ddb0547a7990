"""The scripts that guard packaging can fail; the shell scripts parse."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from clgs.cli.main import COMMANDS
from scripts.checks import check_wheel
from tests.house import rules

ROOT = Path(__file__).resolve().parents[2]

TRACKED = [
    "clgs/__init__.py",
    "clgs/ops/mlp.py",
    "kernels_cl/mlp/forward_cpu.cl",
    "kernels_cl/common/real.h",
]
PACKED = [
    "clgs/__init__.py",
    "clgs/ops/mlp.py",
    "clgs/kernels_cl/mlp/forward_cpu.cl",
    "clgs/kernels_cl/common/real.h",
    "clgs/_codec.abi3.so",
    "clgs-1.0.dist-info/METADATA",
]


def test_a_whole_wheel_passes():
    assert check_wheel.complaints(TRACKED, PACKED) == []
    assert check_wheel.complaints(TRACKED, [*PACKED, "clgs/"]) == []


@pytest.mark.parametrize("name", PACKED[:-2])
def test_a_missing_file_is_named(name):
    rest = [other for other in PACKED if other != name]
    assert f"missing: {name}" in check_wheel.complaints(TRACKED, rest)


def test_a_wheel_without_extension_or_with_two_fails():
    assert check_wheel.complaints(TRACKED, [n for n in PACKED if "_codec" not in n])
    assert check_wheel.complaints(TRACKED, [*PACKED, "clgs/_codec.pyd"])


def test_a_wheel_without_kernels_fails():
    python_only = [name for name in TRACKED if name.startswith("clgs/")]
    packed = [name for name in PACKED if "kernels_cl" not in name]
    assert check_wheel.complaints(python_only, packed) == ["no kernels"]


@pytest.mark.parametrize(
    "name", ["tests/test_x.py", "clgs/left_over.py", "kernels_cl/mlp/forward_cpu.cl"]
)
def test_surplus_files_are_named(name):
    assert check_wheel.complaints(TRACKED, [*PACKED, name]) == [f"not of the package: {name}"]


def test_the_files_of_the_package_are_listed():
    tracked = check_wheel.tracked_files()
    assert {"clgs/__init__.py", "clgs/py.typed", "kernels_cl/gaussian/project.cl"} <= set(tracked)
    assert not [name for name in tracked if "__pycache__" in name]


SHELL = sorted(
    [*(ROOT / "scripts").glob("*.sh"), *(ROOT / "scripts/release").glob("*.sh"), ROOT / ".ci/run"]
)


@pytest.mark.parametrize("path", SHELL, ids=lambda path: path.name)
def test_shell_scripts_parse_and_stop_at_errors(path):
    subprocess.run(["bash", "-n", path], check=True)
    text = path.read_text(encoding="utf-8")
    assert text.startswith("#!/usr/bin/env bash\n")
    assert "\nset -euo pipefail\n" in text
    assert path.stat().st_mode & 0o111, "not executable"


@pytest.mark.parametrize("path", sorted(ROOT.glob("*.md")), ids=lambda path: path.name)
def test_links_in_documents_lead_somewhere(path):
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", path.read_text(encoding="utf-8"))
    assert not [link for link in links if not (ROOT / link).exists()]


def test_the_readme_lists_every_command():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `clgs (\w+)", readme, flags=re.M)
    assert listed == list(COMMANDS)


DISTRIBUTIONS = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "tomli_w": "tomli-w",
    "imageio_ffmpeg": "imageio-ffmpeg",
    "pillow_heif": "pillow-heif",
}
"""Names of packages on PyPI where that is not the name that is imported."""


def test_every_library_that_the_package_imports_is_declared_and_used():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    features = ("plot", "lpips", "tensorboard", "heif", "video", "view", "gsplat", "jax", "torch")
    features += ("distributed", "nerfstudio")
    needed = project["dependencies"] + [one for name in features for one in extras[name]]
    declared = {re.match(r"[\w-]+", one)[0] for one in needed}
    imported = {
        name.split(".")[0]
        for path in (ROOT / "clgs").rglob("*.py")
        for _, name in rules.imported_names(path.read_text(encoding="utf-8"))
    }
    foreign = imported - set(sys.stdlib_module_names) - {"clgs"}
    assert {DISTRIBUTIONS.get(name, name) for name in foreign} == declared


def test_the_changelog_has_the_headings_of_keep_a_changelog():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    kinds = set(re.findall(r"^### (.+)$", text, flags=re.M))
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert re.findall(r"^## (.+)$", text, flags=re.M)[0].startswith("[")


def test_modules_are_found_by_their_names_when_they_are_asked_for():
    code = (
        "import sys, clgs; assert 'clgs.errors' not in sys.modules; clgs.errors.ClgsError\n"
        "assert not any(hasattr(clgs, name) for name in ('nope', '__main__', '_nope'))"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
