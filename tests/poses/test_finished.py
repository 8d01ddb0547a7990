"""A ``prepare`` that is killed at any stage goes on there, and ends with the same bytes."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from clgs.poses.prepare import REPORT, prepare
from tests.data.folders import write_room_photos

pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")

PROCESS = """
import os, signal, sys
from clgs.poses.prepare import prepare
def on_progress(stage, done, total):
    if [stage, str(done)] == sys.argv[3:]:
        os.kill(os.getpid(), signal.SIGKILL)
prepare(sys.argv[1], sys.argv[2], on_progress=on_progress)
"""
KILLS = (("features", "7"), ("geometry", "0"), ("check", "0"))
"""Stages and amounts at which the processes are killed, one after the other."""

SAID = "features of 6 photos, matches, geometry, poses are there already"


def files(folder: Path) -> dict[str, bytes]:
    """The contents of all files; of the report without its times."""
    found = {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
    report = json.loads(found.pop(REPORT))
    assert report.pop("seconds")["features"] > 0
    return {**found, REPORT: json.dumps(report).encode()}


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no such signal")
def test_killed_at_every_stage_it_makes_the_same_bytes(tmp_path: Path, caplog):
    photos, output, at_once = (tmp_path / name for name in ("photos", "data", "at_once"))
    write_room_photos(photos, 7)
    for kill in KILLS:
        command = [sys.executable, "-c", PROCESS, str(photos), str(output), *kill]
        assert subprocess.run(command, timeout=600).returncode == -signal.SIGKILL
        assert not output.exists()
        for kept in tmp_path.glob(".data.*/features/3.png*"):
            kept.unlink()
    stages: list[tuple[str, int]] = []
    prepare(photos, output, on_progress=lambda stage, done, _: stages.append((stage, done)))
    assert caplog.messages == [f"{output}: goes on where an earlier call was stopped: {SAID}"]
    assert {stage for stage, _ in stages} == {"read", "features", "check", "undistort", "report"}
    assert [done for stage, done in stages if stage == "features"] == [6, 7]
    prepare(photos, at_once)
    assert files(output) == files(at_once)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["at_once", "data", "photos"]
