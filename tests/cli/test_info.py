"""``clgs info``: errors, and the table of a nested description."""

import json
from dataclasses import replace

import numpy as np
import pytest

from clgs.cli.commands.info import flatten
from clgs.cli.main import main
from clgs.codec.scene_encoder import encode
from clgs.exports.splats.spz import encode_spz
from tests.codec.scenes import random_scene
from tests.exports.splats.cases import gaussians


def test_a_missing_file_exits_3(tmp_path, refusal):
    assert "none.clgs: no such file" in refusal(3, "info", tmp_path / "none.clgs")
    said = refusal(3, "info", "https://example.org/scene.clgs")
    assert "or read the address by clgs.decode" in said


@pytest.mark.parametrize("data", [b"", b"x", b"PK\x03\x04" * 100, bytes(1000)])
def test_another_file_exits_3(tmp_path, refusal, data):
    (tmp_path / "x.clgs").write_bytes(data)
    refusal(3, "info", tmp_path / "x.clgs")


def test_a_file_that_is_cut_is_called_so(tmp_path, capsys):
    path = tmp_path / "s.clgs"
    data = encode(random_scene(np.random.default_rng(0), 60), layers=2)
    path.write_bytes(data[:-7])
    assert main(["info", str(path)]) == 0
    said = capsys.readouterr()
    assert "settings.photos" not in said.out
    assert said.err == f"clgs: warning: {path}: the file is cut; 7 bytes are missing\n"
    path.write_bytes(data)
    assert main(["info", str(path)]) == 0
    said = capsys.readouterr()
    assert ("missing" in said.out, said.err) == (False, "")


def test_splats_of_any_format_are_described(tmp_path, output_of):
    (tmp_path / "s.spz").write_bytes(encode_spz(replace(gaussians(1), antialiased=True)).data)
    found = json.loads(output_of("info", tmp_path / "s.spz", "--json"))
    assert (found["splats"], found["degree"], found["antialiased"]) == (500, 1, True)
    least, greatest = found["extent"]["least"], found["extent"]["greatest"]
    np.testing.assert_allclose(least, gaussians(1).mean.min(axis=0), atol=1e-4)
    np.testing.assert_allclose(greatest, gaussians(1).mean.max(axis=0), atol=1e-4)


def test_a_nested_description_becomes_rows():
    value = {"a": 12345, "b": {"c": [1.0, 2.0]}, "sections": [{"tag": "META"}, {"tag": "ANCH"}]}
    assert list(flatten(value)) == [
        ("a", "12,345"),
        ("b.c", "1.0 2.0"),
        ("sections.0.tag", "META"),
        ("sections.1.tag", "ANCH"),
    ]
