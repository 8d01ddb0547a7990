"""What the functions of the library refuse before they begin: one line that names the argument."""

from __future__ import annotations

import pytest

import clgs
from clgs.errors import UsageError
from clgs.workflow.runs.plan import Presentation


@pytest.mark.parametrize(
    ("call", "given", "error", "match"),
    [
        ("export", {"sh_degree": 4}, UsageError, "sh_degree: 4 is out of range; give 0 to 3"),
        ("export", {"sh_degree": "2"}, TypeError, "sh_degree: '2'; an integer"),
        ("export", {"steps": -1}, UsageError, "steps: -1 is out of range; give 0 to 100000"),
        ("export", {"units": "feet"}, UsageError, "units: 'feet'; known are data, scene"),
        ("export", {"name": 5}, TypeError, "name: is int, str is needed"),
        ("run", {"seconds": -1}, UsageError, "seconds: -1 is not a finite number above 0"),
        ("run", {"seconds": float("nan")}, UsageError, "seconds: nan is not"),
        ("run", {"steps": 0}, UsageError, "steps: 0 is out of range; give at least 1"),
        ("run", {"max_size": 3}, UsageError, "max_size: 3 is out of range; give .* at least 16"),
        ("run", {"max_size": 2.5}, TypeError, "max_size: 2.5; an integer"),
        ("run", {"settings": {"nope": 1}}, UsageError, "TrainConfig has no setting 'nope'"),
        ("run", {"settings": {"learning_rates.sh": 1}}, UsageError, "LearningRates has .* 'sh'"),
        ("run", {"shown": "title"}, TypeError, "shown: is str, Presentation is needed"),
        (
            "run",
            {"shown": Presentation(path="none", seconds=3.0)},
            UsageError,
            "--clip none: there",
        ),
        ("prepare", {"seed": "a"}, TypeError, "seed: 'a'; an integer"),
        ("prepare", {"frames": -3}, UsageError, "frames: -3 is out of range; give at least 1"),
        ("prepare", {"max_size": -1}, UsageError, "max_size: -1 is out of range; give at least 0"),
    ],
)
def test_values_that_cannot_be_used(tmp_path, call, given, error, match):
    with pytest.raises(error, match=match):
        getattr(clgs, call)(tmp_path, tmp_path / "new.ply", **given)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("memory", "error"), [(-1, UsageError), (1.5, TypeError)])
def test_budgets_that_are_none(memory, error):
    with pytest.raises(error, match=f"max_memory: {memory}"):
        clgs.render_options("parity", memory)
