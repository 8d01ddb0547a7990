"""The codec's sources in C: the compiler warns of nothing, every fuzz target has first inputs."""

from __future__ import annotations

import os
import re
import shutil
import subprocess

import pytest

from tests.codec.scenes import ROOT

if not (ROOT / "CMakeLists.txt").is_file():
    pytest.skip("needs the checkout: CMakeLists.txt is not there", allow_module_level=True)

from scripts.fuzz import seeds


def test_every_target_has_seeds():
    targets = {path.stem for path in (ROOT / "codec_c" / "fuzz").glob("*.c")}
    assert {target for target, _, _ in seeds.all_seeds()} == targets


def test_no_source_of_the_codec_makes_a_warning(tmp_path):
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if not compiler:
        pytest.skip("needs a C compiler: cc is not on the path")
    options = re.search(
        r"target_compile_options\(clgs_options INTERFACE (-Wall[^)]*)\)",
        (ROOT / "CMakeLists.txt").read_text(),
    )
    assert options, "CMakeLists.txt names its warnings elsewhere"
    sources = sorted((ROOT / "codec_c" / "src").rglob("*.c"))
    assert len(sources) > 10
    # optimised, as some warnings come from there alone
    command = [*compiler.split(), "-std=c11", "-O2", *options[1].split(), "-Werror"]
    folders = (ROOT / "codec_c" / name for name in ("include", "src"))
    command += [*(f"-I{folder}" for folder in folders), "-c", *map(str, sources)]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
