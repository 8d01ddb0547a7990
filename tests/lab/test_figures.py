"""Files of figures, those of `clgs eval` included: none is replaced unasked."""

from __future__ import annotations

import pytest

from clgs.cli import main as cli


@pytest.mark.parametrize(
    ("command", "there"),
    [
        ("eval s.clgs --data data --json there.json", "there.json"),
        ("eval s.clgs --data data --inria scores", "scores/results.json"),
        ("eval s.clgs --data data --inria scores", "scores/per_view.json"),
        ("selftest --json there.json", "there.json"),
        *((f"{name} -o there.json", "there.json") for name in ("accept", "conformance")),
        *((f"bench {kind} --json there.json", "there.json") for kind in ("step", "ops", "codec")),
        *((f"bench {kind} -o there.json", "there.json") for kind in ("accuracy", "scaling")),
    ],
)
def test_figures_take_the_place_of_nothing(tmp_path, monkeypatch, capsys, command, there):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / there
    file.parent.mkdir(exist_ok=True)
    file.write_text("kept")
    assert cli.main(command.split()) == 2
    said = f"clgs: error: {there}: exists already; add --overwrite or choose another name\n"
    assert capsys.readouterr().err == said
    assert file.read_text() == "kept"
