"""The codec's sources in C: every fuzz target has first inputs."""

from __future__ import annotations

import pytest

from tests.codec.scenes import ROOT

if not (ROOT / "CMakeLists.txt").is_file():
    pytest.skip("needs the checkout: CMakeLists.txt is not there", allow_module_level=True)

from scripts.fuzz import seeds


def test_every_target_has_seeds():
    targets = {path.stem for path in (ROOT / "codec_c" / "fuzz").glob("*.c")}
    assert {target for target, _, _ in seeds.all_seeds()} == targets
