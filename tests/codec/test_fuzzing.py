"""The fuzz targets in C have first inputs."""

from __future__ import annotations

import pytest

from tests.codec.scenes import ROOT

if not (ROOT / "clgs").is_dir():
    pytest.skip("needs a checkout", allow_module_level=True)

from scripts.fuzz import seeds


def test_every_target_has_seeds():
    targets = {path.stem for path in (ROOT / "codec_c" / "fuzz").glob("*.c")}
    assert {target for target, _, _ in seeds.all_seeds()} == targets
