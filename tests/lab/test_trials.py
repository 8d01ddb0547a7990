"""`clgs accept`: a part that fails ends alone, and what the parts found is in the file."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from clgs.cli import main as cli
from clgs.data.dataset import load_dataset
from clgs.errors import ClgsError
from clgs.lab import trials as trial_module
from clgs.lab.trials import (
    FORMAT,
    QUICK,
    VIEWS,
    WHOLE,
    Trial,
    run_trial,
    run_trials,
    trials,
    write_photos,
)

DEVICE = {"index": 0, "name": "cpu", "platform": "PoCL", "driver": "1"}
HELP = Trial("help", ("--version",), lambda folder: "it runs")


def test_what_a_command_says_is_shown(tmp_path):
    outcome = run_trial(HELP, tmp_path)
    assert (outcome.passed, outcome.exit_code, outcome.summary) == (True, 0, "it runs")
    assert outcome.printed.startswith("clgs ")


def test_failures_are_shown_and_end_alone(tmp_path):
    todo = [
        replace(HELP, name="usage", words=("nonsense",)),
        replace(HELP, name="unreadable", summary=Mock(side_effect=KeyError("step"))),
        replace(HELP, name="wrong", summary=Mock(side_effect=ClgsError("another file"))),
        HELP,
    ]
    outcomes = run_trials(todo, tmp_path, DEVICE, tmp_path / "accept.json")
    assert [one.passed for one in outcomes] == [False, False, False, True]
    usage, unreadable, wrong_file, _ = (one.summary for one in outcomes)
    assert usage.startswith("exit code 2: ")
    assert unreadable == "its figures cannot be read: KeyError"
    assert wrong_file == "another file"
    record = json.loads((tmp_path / "accept.json").read_text())
    assert record["format"] == FORMAT
    assert record["device"] == DEVICE
    assert [one["name"] for one in record["parts"]] == ["usage", "unreadable", "wrong", "help"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_crash_and_a_hang_are_shown(tmp_path, monkeypatch):
    monkeypatch.setattr(trial_module, "_CODE", "import os, signal; os.kill(os.getpid(), 11)")
    assert run_trial(HELP, tmp_path).summary == "crashed: signal 11"
    monkeypatch.setattr(trial_module, "_CODE", "import time; time.sleep(600)")
    outcome = run_trial(HELP, tmp_path, seconds=0.2)
    assert (outcome.passed, outcome.exit_code) == (False, None)
    assert outcome.summary == "took too long and was stopped"


def test_every_part_is_a_command_with_its_options(tmp_path):
    for size in (QUICK, WHOLE):
        todo = trials("0", tmp_path, size, ["data", "--steps", "1000", "--downscale", "8"])
        assert len({trial.name for trial in todo}) == len(todo)
        for trial in todo:
            args = cli.build_parser().parse_args(trial.words)
            assert getattr(args, "device", "0") == "0"
            if trial.name == "training":
                assert args.start_points == size.points
            if trial.name in ("stages", "step", "large step"):
                assert args.repeats == size.repeats


def test_trainings_that_differ_fail(tmp_path):
    todo = {trial.name: trial for trial in trials("0", tmp_path, QUICK, [])}
    for name in ("training", "training again"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "scene.clgs").write_bytes(b"one")
    assert todo["training again"].summary(tmp_path) == todo["training"].summary(tmp_path)
    (tmp_path / "training again" / "scene.clgs").write_bytes(b"two")
    with pytest.raises(ClgsError, match="another file"):
        todo["training again"].summary(tmp_path)


def test_the_photos_are_the_same_everywhere(tmp_path):
    write_photos(tmp_path / "photos")
    data = load_dataset(tmp_path / "photos")
    views = sorted([*data.train, *data.test], key=lambda view: view.name)
    assert len(views) == VIEWS
    pixels = np.stack([view.photo.pixels().color for view in views])
    assert int(pixels.sum(dtype=np.int64)) == 15_007_424
    axes = np.stack([view.camera.rotation for view in views])
    assert np.allclose(axes @ axes.transpose(0, 2, 1), np.eye(3))


@pytest.mark.parametrize(
    ("option", "value", "code"), [("--data", "no data", 3), ("--device", "nonexistent", 4)]
)
def test_what_cannot_be_used_is_refused_at_once(tmp_path, refusal, option, value, code):
    (tmp_path / "no data").mkdir()
    given = tmp_path / value if option == "--data" else value
    assert str(given) in refusal(code, "accept", "-o", tmp_path / "accept.json", option, given)
    assert not (tmp_path / "accept.json").exists()


@pytest.mark.slow
def test_everything_passes_here(tmp_path, output_of):
    printed = output_of("accept", "-o", tmp_path / "accept.json", "--quick")
    assert "conformance again  ok" in printed
    assert "the same bits" in printed
    record = json.loads((tmp_path / "accept.json").read_text())
    assert all(one["passed"] for one in record["parts"])
    figures = {one["name"]: one["figures"] for one in record["parts"] if "figures" in one}
    assert figures["step"]["step"] > 0
    assert len(figures["conformance"]["tensors"]) == 240
    assert str(tmp_path) not in json.dumps(record)
