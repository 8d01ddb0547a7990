"""``clgs info``: errors, and the table of a nested description."""

from __future__ import annotations

import pytest

from clgs.cli.commands.info import flatten
from clgs.cli.main import main


def test_a_missing_file_exits_3(tmp_path, capsys):
    assert main(["info", str(tmp_path / "none.clgs")]) == 3
    assert "none.clgs: no such file" in capsys.readouterr().err


@pytest.mark.parametrize("data", [b"", b"x", b"PK\x03\x04" * 100, bytes(1000)])
def test_another_file_exits_3(tmp_path, capsys, data):
    (tmp_path / "x.clgs").write_bytes(data)
    assert main(["info", str(tmp_path / "x.clgs")]) == 3
    assert capsys.readouterr().err.count("\n") == 1


def test_a_nested_description_becomes_rows():
    value = {"a": 12345, "b": {"c": [1.0, 2.0]}, "sections": [{"tag": "META"}, {"tag": "ANCH"}]}
    assert list(flatten(value)) == [
        ("a", "12,345"),
        ("b.c", "1.0 2.0"),
        ("sections.0.tag", "META"),
        ("sections.1.tag", "ANCH"),
    ]
