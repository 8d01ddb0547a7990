"""Progress of stages where the output is no terminal."""

from __future__ import annotations

from clgs.cli.stages import StageDisplay, describe


def test_lines_tell_counts_and_the_time_left():
    assert describe("matches", 300, 1225, 60.0) == "matches 300/1225, 60 s, about 185 s left"
    assert describe("matches", 0, 1225, 0.0) == "matches 0/1225"
    assert describe("matches", 1225, 1225, 240.0) == "matches 1225/1225, 240 s"
    assert describe("undistort", 0, 0, 0.0) == "undistort"


def test_a_line_for_every_stage_and_now_and_then(capsys):
    seconds = [0.0]
    with StageDisplay(lambda: seconds[0]) as display:
        for now, done in ((0, 0), (4, 1), (12, 2), (14, 3), (30, 4)):
            seconds[0] = float(now)
            display.update("features", done, 4)
        display.update("matches", 0, 6)
    assert capsys.readouterr().err.splitlines() == [
        "features 0/4",
        "features 2/4, 12 s, about 12 s left",
        "features 4/4, 30 s",
        "matches 0/6",
    ]
