"""A run that is interrupted at any moment ends as if it had not been."""

from __future__ import annotations

import os
import re
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import clgs
from clgs.errors import DataError
from clgs.train.config import preset
from clgs.train.run.session import interruptions, train_scene
from tests.small_scene import write_scene

STEPS = 160
README = Path(__file__).parents[3] / "README.md"


def config():
    return replace(preset("default").scaled(STEPS), voxel=0.05, log_interval=50)


def interrupt_at(step):
    def on_progress(progress):
        if progress.result.step == step:
            os.kill(os.getpid(), signal.SIGINT)

    return on_progress


def test_interrupted_runs_end_alike(dataset, open_device, tmp_path):
    device = open_device("cpu")
    whole = train_scene(dataset, tmp_path / "whole", config(), device=device)
    for step in (60, 115):
        with pytest.raises(KeyboardInterrupt):
            train_scene(
                dataset,
                tmp_path / "legs",
                config(),
                device=device,
                resume=True,
                on_progress=interrupt_at(step),
            )
    legs = train_scene(dataset, tmp_path / "legs", config(), device=device, resume=True)
    assert legs.bitstream == whole.bitstream
    seconds = legs.summary["train_seconds"]
    assert seconds > 0
    rows = (tmp_path / "legs" / "progress.csv").read_text().splitlines()
    steps = [int(row.split(",")[0]) for row in rows[1:]]
    assert steps == sorted(steps)
    # other photos under the same name: the checkpoint is refused
    other = replace(dataset, points=dataset.points[:-5])
    with pytest.raises(DataError, match="other settings or photos"):
        train_scene(other, tmp_path / "legs", config(), device=device, resume=True)


def test_signals_wait_for_the_step():
    # a shell's background job starts with SIGINT ignored
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with interruptions() as interrupted:
            assert not interrupted()
            os.kill(os.getpid(), signal.SIGINT)
            assert interrupted()
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(not README.is_file(), reason="README.md is not installed with the package")
def test_python_example_of_the_readme_runs(tmp_path, monkeypatch):
    example = re.search(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert example is not None
    write_scene(tmp_path / "DATA")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("clgs.data.points.HULL_POINTS", 3000)  # for speed
    code = example[1].replace('preset("quick")', 'preset("quick").scaled(20)')
    names: dict[str, object] = {}
    exec(compile(code, "README.md", "exec"), names)
    assert (tmp_path / "scene.npz").is_file()
    assert np.asarray(names["picture"]).shape == (3, 20, 20)


def test_every_public_name_is_there():
    for name in clgs.__all__:
        assert callable(getattr(clgs, name)), name
        assert callable(getattr(clgs, name)), f"{name} after the first use"
