"""The pages for newcomers work: what they list is carried out in a copy of the tree."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from clgs import _codec

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "contributing"
LEFT_OUT = {"build", "dist"}
"""Folders that are made from the sources; so are hidden ones, but for .ci."""

RUN = """\
import sys
sys.meta_path[:] = [one for one in sys.meta_path if "ScikitBuild" not in type(one).__name__]
sys.path.insert(0, "")
import clgs
assert clgs.__file__.startswith(sys.argv[1]), clgs.__file__
if sys.argv[2] == "clgs":
    from clgs.cli.main import main
    sys.exit(main(sys.argv[3:]))
import pytest
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", *sys.argv[3:]]))
"""
"""Without the finder of the installed package, which would import it from the checkout."""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of the checkout's sources that can run."""
    caches = shutil.ignore_patterns("__pycache__")
    for entry in ROOT.iterdir():
        made = entry.name in LEFT_OUT or (entry.name[0] == "." and entry.name != ".ci")
        if entry.is_dir() and not made:
            shutil.copytree(entry, tmp_path / entry.name, ignore=caches)
        elif entry.is_file():
            shutil.copy(entry, tmp_path)
    (tmp_path / "clgs" / "kernels_cl").symlink_to(tmp_path / "kernels_cl")
    extension = Path(_codec.__file__)
    (tmp_path / "clgs" / extension.name).symlink_to(extension)
    return tmp_path


def run(tree: Path, *words: str) -> str:
    """The output of ``pytest`` or ``clgs`` with further words, in the copy."""
    code = [sys.executable, "-c", RUN, str(tree), *words]
    done = subprocess.run(code, cwd=tree, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def listings(page: str, kind: str) -> list[str]:
    """The listings of one kind on a page, such as "python"."""
    text = (PAGES / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{kind}\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)


@pytest.mark.skipif(shutil.which("git") is None, reason="git applies the page's changes")
def test_the_first_change(tree: Path) -> None:
    for change in listings("first_change.md", "diff"):
        words = ["git", "apply", "-"]
        done = subprocess.run(words, cwd=tree, input=change, text=True, capture_output=True)
        assert done.returncode == 0, f"first_change.md: a listing no longer applies: {done.stderr}"
    (test,) = listings("first_change.md", "python")
    (tree / "tests" / "train" / "step" / "test_warm_up.py").write_text(test)
    run(tree, "pytest", "tests/train/step/test_warm_up.py", "tests/train/step/test_schedule.py")
    assert "--warm-up" in run(tree, "clgs", "train", "--help")


@pytest.mark.slow
def test_add_an_op(tree: Path) -> None:
    text = (PAGES / "add_an_op.md").read_text(encoding="utf-8")
    pattern = r"^## \d\. [^\n]*`(\S+)`\n.*?^```(?:python|c)\n(.*?)^```$"
    files = re.findall(pattern, text, flags=re.DOTALL | re.MULTILINE)
    assert len(files) == 5
    for path, content in files:
        assert not (tree / path).exists()
        (tree / path).write_text(content)
    run(tree, "pytest", "-m", "not release",
        "tests/ops/test_contrast.py", "tests/reference/test_contrast_gradients.py",
        "tests/house/test_architecture.py", "tests/house/test_kernel_rules.py",
        "tests/house/test_kernel_constants.py")  # fmt: skip
