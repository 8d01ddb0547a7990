"""Compiling kernels is announced once, and only if they are compiled."""

from __future__ import annotations

import logging

from clgs.cli.tell import LOGGER, show_notes
from clgs.opencl import programs
from clgs.opencl.device import Device


def test_compiling_is_told_once(monkeypatch, caplog, capsys):
    assert LOGGER == programs.NOTES
    seconds = iter([0.0, 1.0, 1.0, 2.0, 2.0, 3.0])
    monkeypatch.setattr(programs.time, "thread_time", lambda: next(seconds))
    device = Device()
    with caplog.at_level(logging.INFO, programs.NOTES):
        for value in range(3):
            device.kernel("loss/mask", "mask_apply", UNUSED=value)
    assert [record.getMessage() for record in caplog.records] == [
        f"compiling kernels for {device.name} (once)"
    ]


def test_kernels_from_the_cache_are_not(monkeypatch, caplog):
    monkeypatch.setattr(programs.time, "thread_time", lambda: 0.0)
    with caplog.at_level(logging.INFO, programs.NOTES):
        Device().kernel("loss/mask", "mask_apply")
    assert not caplog.records


def test_notes_are_shown_where_standard_error_is_now(capsys):
    logger = logging.getLogger(programs.NOTES)
    before = logger.handlers[:], logger.level, logger.propagate
    try:
        show_notes()
        show_notes()
        logger.info("compiling")
        assert capsys.readouterr().err == "clgs: compiling\n"
    finally:
        logger.handlers, logger.level, logger.propagate = before
