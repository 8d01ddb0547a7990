"""One process at a time works in the folder of a run."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import pytest

from clgs.errors import DataError
from clgs.train.config import preset
from clgs.train.run.run_folder import FolderLock
from clgs.train.run.session import train_scene

pytestmark = pytest.mark.skipif(os.name == "nt", reason="folders cannot be locked on Windows")
HOLDER = """
import sys, time
from pathlib import Path
from clgs.train.run.run_folder import FolderLock
lock = FolderLock(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(600)
"""


def test_a_folder_is_held_until_it_is_released(tmp_path):
    lock = FolderLock(tmp_path)
    with pytest.raises(DataError, match="another process works in it"):
        FolderLock(tmp_path)
    lock.release()
    lock.release()
    FolderLock(tmp_path).release()
    assert not list(tmp_path.iterdir())


def test_a_killed_process_lets_go(tmp_path):
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(DataError, match="another process"):
            FolderLock(tmp_path)
        holder.kill()
    FolderLock(tmp_path).release()


def test_a_run_that_goes_on_is_left_alone(dataset, open_device, tmp_path):
    device, run = open_device("cpu"), tmp_path / "run"
    config = replace(preset("default").scaled(20), voxel=0.05, log_interval=10)
    refused = []

    def intrude(progress):
        if progress.result.step == 10:
            with pytest.raises(DataError, match="another process works in it"):
                train_scene(dataset, run, config, device=device)
            for overwrite in (False, True):
                with pytest.raises(DataError, match="another process"):
                    train_scene(
                        dataset, run, config, device=device, resume=not overwrite,
                        overwrite=overwrite,
                    )  # fmt: skip
                refused.append(overwrite)

    alone = train_scene(dataset, tmp_path / "alone", config, device=device)
    found = train_scene(dataset, run, config, device=device, on_progress=intrude)
    assert refused == [False, True]
    assert found.bitstream == alone.bitstream
    again = train_scene(dataset, run, config, device=device, overwrite=True)
    assert again.bitstream == alone.bitstream
