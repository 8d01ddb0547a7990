"""The program of docs/guide/read_a_file.md has 30 lines, runs, and makes the Gaussians of clgs."""

from __future__ import annotations

import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.scene_decoder import decode
from clgs.codec.scene_encoder import encode
from clgs.reference import mlp, neural
from clgs.scene.mlps import init_mlps
from tests.codec.scenes import ROOT, random_scene

PAGE = ROOT / "docs" / "guide" / "read_a_file.md"
if not PAGE.is_file():
    pytest.skip("needs the checkout: docs is not there", allow_module_level=True)


def test_the_program_of_the_guide(rng, tmp_path, monkeypatch, capsys):
    program = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    assert len(program.splitlines()) <= 30
    scene = replace(random_scene(rng), mlps=init_mlps(rng))
    file = tmp_path / "scene.clgs"
    file.write_bytes(encode(scene))
    monkeypatch.setattr(sys, "argv", ["read.py", str(file)])
    found: dict = {}
    exec(program, found)  # the page is a file of this repository
    drawn = found["opacity"] > 0
    assert f"{drawn.sum():,} Gaussians" in capsys.readouterr().out
    scene = decode(file.read_bytes())
    anchors = scene.dequantize().anchors.map(lambda array: array.astype(np.float64))
    camera = np.zeros(26)
    camera[mlp.CENTRE] = found["eye"]
    visible = np.arange(len(anchors), dtype=np.int32)
    weights = scene.mlps.flat.astype(np.float64)
    output = mlp.forward(anchors.feature, anchors.position, visible, weights, camera).output
    expected = neural.forward(output, visible, anchors.position, anchors.offset, anchors.scaling)
    for name in ("mean", "scale", "color", "opacity"):
        np.testing.assert_allclose(
            found[name][drawn], getattr(expected, name), rtol=1e-5, atol=1e-5
        )
    rotation = found["rotation"][drawn]
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    np.testing.assert_allclose(rotation / length, expected.rotation, atol=1e-5)
