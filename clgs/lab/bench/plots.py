"""What all figures of benchmarks share; matplotlib is an optional dependency."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from clgs.errors import ClgsError, UsageError
from clgs.files import atomic_path, check_target
from clgs.workflow.outputs import check_new

PANEL = (4.6, 3.4)
"""Inches."""

MARKERS = "osD^vPX*"
STYLE = {
    "svg.hashsalt": "clgs",
    "svg.fonttype": "none",
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def require_pyplot() -> Any:
    """matplotlib.pyplot, drawing without a screen.

    Raises:
        ClgsError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError:
        raise ClgsError('plots need matplotlib: pip install "clgs[plot]"') from None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def check_figure_files(output: Path | None, plot: Path | None, overwrite: bool) -> None:
    """Refuse, before anything is measured, files that could not be written.

    Raises:
        UsageError: ``plot`` is no .svg file, or the same file as ``output``.
        ClgsError: matplotlib is missing.
        ExistsError, OutputError: as of :func:`clgs.workflow.outputs.check_new`.
    """
    if plot and plot.suffix.lower() != ".svg":
        raise UsageError(f"{plot}: plots are SVG; name a file that ends in .svg")
    targets = [check_target(path) for path in (output, plot) if path]
    if len(set(targets)) < len(targets):
        raise UsageError(f"{plot}: --output and --plot name the same file; choose two")
    for path in filter(None, (output, plot)):
        check_new(path, overwrite)
    if plot:
        require_pyplot()


def save(figure: Any, path: Path) -> None:
    """Write the figure as SVG with the same bytes for the same figures."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="svg", metadata={"Date": None})
    require_pyplot().close(figure)
