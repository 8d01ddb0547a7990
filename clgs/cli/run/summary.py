"""The last thing that `clgs run` shows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clgs.cli.counted import counted
from clgs.cli.run.duration import in_words


def print_box(
    out: Path,
    photos: str,
    scores: Mapping[str, Any],
    seconds: Mapping[str, float],
) -> None:
    """A box of the run's numbers.

    Args:
        out: folder of the run.
        photos: how many there were, in words.
        scores: as `clgs eval --json` gives them.
        seconds: by stage, over all calls that worked on the run.
    """
    from rich.console import Console
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for name, value in rows(out, photos, scores, seconds):
        table.add_row(Text(name, style="dim"), Text(value))
    Console().print(Panel(table, title="clgs run: done", border_style="green", expand=False))


def rows(
    out: Path,
    photos: str,
    scores: Mapping[str, Any],
    seconds: Mapping[str, float],
) -> list[tuple[str, str]]:
    """Labels and values of the box."""
    stages = "  ".join(f"{name} {one:.0f}" for name, one in seconds.items())
    split = "held-out view" if scores["split"] == "test" else "training view"
    views = counted(scores["views"], split)
    return [
        ("photos", photos),
        ("PSNR", f"{scores['psnr']:.2f} dB on {views}, from the file"),
        ("SSIM", f"{scores['ssim']:.4f}"),
        ("bytes", f"{scores['bytes']:,} for {scores['anchors']:,} anchors"),
        ("time", f"{in_words(sum(seconds.values()))}; seconds: {stages}"),
        ("look at", str(out / "report.html")),
    ]
