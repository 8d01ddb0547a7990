"""A run whose disk is full keeps what it trained, says what helps, and can be resumed."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
from contextlib import suppress
from dataclasses import replace

import pytest

from clgs.errors import ClgsError
from clgs.train.config import preset
from clgs.train.run import progress
from clgs.train.run.progress import FullDiskError
from clgs.train.run.session import train_scene

STEPS = 12
CONFIG = replace(preset("default").scaled(STEPS), voxel=0.05, checkpoint_interval=5, log_interval=3)


class Disk:
    """A disk that is full when the test says so."""

    def __init__(self):
        self.full = False
        self.waits = 0
        self.free_after = 3

    def fsync(self, descriptor):
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")

    def sleep(self, seconds):
        self.waits += 1
        assert self.waits <= self.free_after
        self.full = self.waits < self.free_after

    def between(self, first, last):
        """What makes it full after step ``first`` and free again after ``last``."""

        def on_progress(progress):
            self.full = first <= progress.result.step < last

        return on_progress


@pytest.fixture
def disk(monkeypatch):
    disk = Disk()
    monkeypatch.setattr(os, "fsync", disk.fsync)
    monkeypatch.setattr(progress.time, "sleep", disk.sleep)
    return disk


@pytest.fixture(scope="module")
def whole(dataset, open_device, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "run"
    return train_scene(dataset, folder, CONFIG, device=open_device("cpu")).bitstream


@pytest.fixture
def train(dataset, open_device, tmp_path):
    """Train in one folder, resuming."""

    def train_more(on_progress=None, config=CONFIG, folder=tmp_path / "run"):
        device = open_device("cpu")
        return train_scene(
            dataset, folder, config, device=device, resume=True, on_progress=on_progress
        )

    return train_more


def steps(folder):
    return [int(path.stem[5:]) for path in sorted((folder / "checkpoint").glob("step_*.npz"))]


@pytest.mark.slow
def test_training_goes_on_and_the_next_try_comes_sooner(
    disk, train, whole, tmp_path, monkeypatch, caplog
):
    monkeypatch.setattr(progress, "RETRY_STEPS", 2)
    result = train(disk.between(3, 7))
    assert result.bitstream == whole
    assert disk.waits == 0
    assert steps(tmp_path / "run") == [10, 12]
    (said,) = [record.getMessage() for record in caplog.records]
    assert "step_00000005.npz: No space left on device; free space" in said
    assert said.endswith("training goes on and tries again")


@pytest.mark.slow
def test_a_trained_scene_waits_for_room(disk, train, whole, caplog):
    result = train(disk.between(11, 99))
    assert disk.waits == 3
    assert result.bitstream == whole
    last = caplog.records[-1].getMessage()
    assert "scene.npz: No space left on device; free space" in last
    assert "up to 10 minutes" in last


@pytest.mark.slow
def test_without_room_the_last_checkpoint_is_named_and_resumed(
    disk, train, whole, tmp_path, monkeypatch
):
    monkeypatch.setattr(progress, "WAIT_SECONDS", 0.0)
    with pytest.raises(FullDiskError, match=r"scene\.npz: No space left on device; free") as caught:
        train(disk.between(6, 99))
    assert str(caught.value).endswith("repeat the command with --resume: it goes on after step 5")
    assert "\n" not in str(caught.value)
    assert steps(tmp_path / "run") == [5]
    disk.full = False
    resumed: list[int] = []
    result = train(lambda progress: resumed.append(progress.result.step))
    assert resumed == list(range(6, STEPS + 1))
    assert result.bitstream == whole


@pytest.mark.slow
def test_results_without_room_cost_no_training(disk, train, whole, monkeypatch):
    """The last step is in a checkpoint: nothing to wait for."""
    with monkeypatch.context() as patch:
        patch.setattr("clgs.train.run.session.save_scene", no_room)
        with pytest.raises(FullDiskError, match=f"scene.npz.*goes on after step {STEPS}"):
            train()
    assert disk.waits == 0
    resumed: list[int] = []
    result = train(lambda progress: resumed.append(progress.result.step))
    assert resumed == []
    assert result.bitstream == whole


def no_room(path, scene):
    raise OSError(errno.ENOSPC, "No space left on device", str(path))


@pytest.mark.slow
def test_other_faults_are_not_waited_for(disk, train, monkeypatch):
    def broken(path, scene):
        raise OSError(errno.EIO, "Input/output error", str(path))

    monkeypatch.setattr("clgs.train.run.session.save_scene", broken)
    with pytest.raises(OSError, match="Input/output error"):
        train()
    assert disk.waits == 0


def test_an_interrupt_on_a_full_disk_says_what_is_lost(disk, train):
    def on_progress(progress):
        disk.full = True
        if progress.result.step == 3:
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(FullDiskError, match=r"checkpoint.*No space left.*it starts again"):
        train(on_progress)


@pytest.fixture
def small_disk(tmp_path):
    """A folder on a file system of 16 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", str(folder)]
    if not shutil.which("mount") or subprocess.run(command, check=False).returncode:
        pytest.skip("a small file system can be mounted by root on Linux only")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def take_all(path):
    """Leave no room next to ``path``."""
    with path.open("ab", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))


@pytest.mark.slow
def test_a_file_system_that_really_fills_up(small_disk, train, whole, monkeypatch):
    monkeypatch.setattr(progress, "WAIT_SECONDS", 0.0)
    run, ballast = small_disk / "run", small_disk / "ballast"

    def fill_up(progress):
        if progress.result.step == 7:
            take_all(ballast)

    with pytest.raises(FullDiskError, match="goes on after step 5") as caught:
        train(fill_up, folder=run)
    assert caught.value.exit_code == ClgsError.exit_code
    assert steps(run) == [5]
    with pytest.raises(OSError, match="No space left"):  # still no room for anything
        train(folder=run)
    ballast.unlink()
    assert train(folder=run).bitstream == whole
