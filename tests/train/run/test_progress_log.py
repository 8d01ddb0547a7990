"""The log of a run: what of a damaged file is used again, and rows for which there is no room."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from clgs.errors import DataError
from clgs.train.run.progress import COLUMNS, ProgressLog
from clgs.train.run.trainer import StepResult

HEADER = ",".join(COLUMNS) + "\r\n"
ROWS = "10,1.5,0.1,0.1,0.9,20.000,5,100,\r\n11,1.6,,,,21.500,,,psnr before quantisation\r\n"


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    """A clock that stands still at 7 seconds."""
    still = SimpleNamespace(perf_counter=lambda: 7.0)
    monkeypatch.setattr("clgs.train.run.progress.time", still)


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "progress.csv"
    path.write_bytes((HEADER + ROWS).encode())
    return path


def test_a_resumed_log_keeps_the_rows_up_to_the_checkpoint(path):
    log = ProgressLog(path, 10)
    log.event(11, "again", 22.0)
    log.close()
    kept, new = path.read_text().splitlines()[1:]
    assert kept == ROWS.splitlines()[0]
    assert new == "11,1.5,,,,22.000,,,again"
    assert log.events == {"again": 22.0}
    assert log.seconds == 1.5


def test_a_cut_last_row_is_skipped_wherever_it_is_cut(path):
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        log = ProgressLog(path, 20)
        log.close()
        ends = whole[:size].rfind(b"\n") + 1
        assert path.read_bytes() == (whole[:ends] or HEADER.encode())
        assert not log.events


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("10\r\n", "line 2 has not 9 fields"),
        ("10,1,,,,20.0,,,,more\r\n", "line 2 has not 9 fields"),
        ("10,,,,,20.0,,,\r\n", "line 2: step, seconds or psnr"),
        ("10,nan,,,,20.0,,,\r\n", "line 2: step, seconds or psnr"),
        ("ten,1,,,,20.0,,,\r\n", "line 2: step, seconds or psnr"),
        ("10,1,,,,,,,psnr before\r\n", "line 2: step, seconds or psnr"),
        ("\xff\r\n", "can't decode byte"),
    ],
)
def test_a_damaged_row_is_one_line_and_the_file_stays(path, row, reason):
    damaged = HEADER.encode() + row.encode("latin-1") + ROWS.encode()
    path.write_bytes(damaged)
    with pytest.raises(DataError, match=f"not a progress log .*{reason}.*resume again"):
        ProgressLog(path, 20)
    assert path.read_bytes() == damaged


def test_a_log_with_other_columns_is_refused_and_stays(path):
    path.write_bytes(b"step,loss\r\n1,2\r\n")
    with pytest.raises(DataError, match="does not name the columns"):
        ProgressLog(path, 20)
    assert path.read_bytes() == b"step,loss\r\n1,2\r\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_rows_wait_while_the_disk_is_full(path):
    log = ProgressLog(path, 10)
    log.event(11, "first", 20.0)
    log._path = Path("/dev/full")
    log.event(12, "second", 21.0)
    log.write(StepResult(13, "view", 0.1, 0.1, 0.9, None, 5), 20.0, 100)
    with pytest.raises(OSError, match=r"No space left on device: '/dev/full'"):
        log.flush()
    log._path = path
    log.event(14, "third", 22.0)
    log.flush()
    rows = path.read_text().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == ["10", "11", "12", "13", "14"]
    assert all(row.count(",") == len(COLUMNS) - 1 for row in rows)


def test_another_fault_of_the_file_is_named(path):
    log = ProgressLog(path, 10)
    path.unlink()
    path.mkdir()
    with pytest.raises(OSError, match=r"directory: .*progress\.csv"):
        log.event(11, "first", 20.0)
