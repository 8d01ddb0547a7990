"""``clgs bench``: tiny scenes, and remedies that the benchmark itself has."""

from __future__ import annotations

import importlib
import json

import pytest

from clgs.cli import bench, bench_scaling
from clgs.cli.main import main
from clgs.errors import NoRoomError
from clgs.testing.bench_scaling import Memory, Run, Scaling, growth


def test_a_single_gaussian_is_enough(tmp_path):
    file = tmp_path / "times.json"
    tiny = ["--gaussians", "1", "--size", "16", "--repeats", "1", "--json", str(file)]
    assert main(["bench", "step", *tiny]) == 0
    assert json.loads(file.read_text())["anchors"] == 1


@pytest.mark.parametrize("kind", bench.KINDS)
@pytest.mark.parametrize(
    ("error", "code"), [(MemoryError("1 TiB"), 1), (NoRoomError("no room for 1 TiB"), 4)]
)
def test_remedies_are_options_of_the_benchmark(monkeypatch, capsys, kind, error, code):
    def fail(args):
        raise error

    monkeypatch.setattr(importlib.import_module(f"clgs.cli.bench_{kind}"), "run", fail)
    assert main(["bench", kind]) == code
    said = capsys.readouterr().err
    assert main_help(capsys, kind)
    options = [word.strip(",;.\n") for word in said.split() if word.startswith("--")]
    assert options
    assert set(options) <= set(main_help(capsys, kind).split())


def main_help(capsys, kind):
    with pytest.raises(SystemExit):
        main(["bench", kind, "--help"])
    return capsys.readouterr().out.replace(",", " ")


def test_one_size_has_no_exponent(capsys):
    assert growth([(5.0, 1.0)]).exponent is None
    assert growth([(5.0, 1.0), (5.0, 2.0)]).exponent is None
    run = Run(1000, 2000, 3000, 4.0, 5000)
    one = growth([(1000, 4.0)])
    bench_scaling._show(Scaling([run], [run], [run], one, one, Memory(None, 2.0, None)))
    said = capsys.readouterr().out
    assert "nan" not in said
    assert "time ~ count^- " in said
    assert "- bytes a Gaussian and - a pixel" in said
    assert "2 an intersection" in said
