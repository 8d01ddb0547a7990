"""What came out of the demonstration: its numbers, its page, and the box at the end."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from picture import Showcase, draw_showcase

from clgs.errors import DataError
from clgs.export.image import comparison, picture_names, save_png
from clgs.export.report import Report, ReportView, write_report

PAGE, PICTURE = "report.html", "comparison.png"

SECTIONS = {
    "META": "header",
    "CHNK": "chunk table",
    "ANCH": "positions",
    "OFFS": "offsets",
    "FEAT": "features",
    "SCAL": "scaling",
    "MLPS": "networks",
}
"""The file's section tags in words."""


@dataclass(frozen=True)
class Outcome:
    """The demonstration in numbers.

    photos given and registered: counts; scores: as ``clgs eval --json`` writes them; sections:
    bytes of the file; seconds by stage; curve: (step, PSNR) while training.
    """

    photos: int
    registered: int
    scores: dict[str, Any]
    sections: dict[str, int]
    seconds: dict[str, float]
    curve: list[tuple[int, float]]

    @property
    def total_seconds(self) -> float:
        """Of all stages."""
        return sum(self.seconds.values())


@dataclass(frozen=True)
class Target:
    """The bar that the demo sets itself on its own photos: share registered, PSNR in dB."""

    registered: float
    psnr: float

    def misses(self, outcome: Outcome) -> list[str]:
        """What falls short, in words; a PSNR that is not a number falls short too."""
        found = []
        if not outcome.registered >= self.registered * outcome.photos:
            share = f"{outcome.registered} of {outcome.photos}"
            found.append(f"{share} photos found their pose, {self.registered:.0%} are needed")
        if not outcome.scores["psnr"] >= self.psnr:
            found.append(f"held-out PSNR {outcome.scores['psnr']:.2f} dB, below {self.psnr:g} dB")
        return found


def gather(out: Path, info: str, photos: int, seconds: dict[str, float]) -> Outcome:
    """Read the numbers that the stages left in folder ``out``; info: JSON of ``clgs info``."""
    scores = json.loads((out / "scores.json").read_text(encoding="utf-8"))
    return Outcome(
        photos,
        registered_photos(out / "data"),
        scores,
        section_bytes(json.loads(info)),
        seconds,
        read_curve(out / "run" / "progress.csv"),
    )


def registered_photos(data: Path) -> int:
    """Photos that found their pose, of a folder that ``clgs prepare`` made."""
    from clgs.data.dataset import load_dataset

    dataset = load_dataset(data, load_images=False)
    return len(dataset.train) + len(dataset.test)


def section_bytes(info: dict[str, Any]) -> dict[str, int]:
    """Bytes by section, in words, of a .clgs file as ``clgs info --json`` describes it."""
    return {SECTIONS.get(tag, tag): int(size) for tag, size in info["sections"].items()}


def read_curve(path: Path) -> list[tuple[int, float]]:
    """(step, PSNR) of the regular rows of progress.csv; rows of single events are left out."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["psnr"] and not row["event"]]
    return [(int(row["step"]), float(row["psnr"])) for row in rows]


@dataclass(frozen=True)
class HeldOutView:
    """A held-out view: its score as ``clgs eval --json`` writes it, photo and render (H, W, 3)."""

    score: dict[str, Any]
    photo: npt.NDArray[np.uint8]
    render: npt.NDArray[np.uint8]


def held_out_views(out: Path, outcome: Outcome) -> list[HeldOutView]:
    """Every held-out view with its pictures, from the PNG files of folder ``out``."""
    photos = {path.name: path for path in (out / "run" / "test").glob("*/gt/*.png")}
    scores = outcome.scores["per_view"]
    views = []
    for score, name in zip(scores, picture_names([s["name"] for s in scores]), strict=True):
        if name not in photos:
            raise DataError(f"{out / 'run' / 'test'}: no photo {name}; run the demo again")
        views.append(HeldOutView(score, _read(photos[name]), _read(out / "renders" / name)))
    return views


def _read(path: Path) -> npt.NDArray[np.uint8]:
    from PIL import Image

    with Image.open(path) as picture:
        return np.array(picture.convert("RGB"))


def write_pages(out: Path, outcome: Outcome) -> None:
    """report.html, and comparison.png: the view of median PSNR, neither the best nor the worst."""
    views = held_out_views(out, outcome)
    typical = sorted(views, key=lambda view: float(view.score["psnr"]))[len(views) // 2]
    show = Showcase(typical.photo, typical.render, typical.score["psnr"], outcome.sections)
    save_png(out / PICTURE, draw_showcase(show))
    strips = [
        ReportView(v.score["name"], v.score["psnr"], v.score["ssim"], comparison(v.photo, v.render))
        for v in views
    ]
    write_report(out / PAGE, make_report(outcome), strips)


def make_report(outcome: Outcome) -> Report:
    """The page's content."""
    scores = outcome.scores
    anchors = int(scores["anchors"])
    return Report(
        title="From photos to one compressed file and back",
        lead=f"{outcome.registered} of {outcome.photos} photos found their pose; every 8th was "
        "held out of training, and rendered from the decoded file alone.",
        headline=[
            ("PSNR", f"{scores['psnr']:.2f} dB"),
            ("SSIM", f"{scores['ssim']:.4f}"),
            ("scene.clgs", f"{scores['bytes'] / 2**10:,.0f} KiB"),
            ("anchors", f"{anchors:,}"),
            ("seconds", f"{outcome.total_seconds:,.0f}"),
        ],
        sections=outcome.sections,
        seconds=outcome.seconds,
        curve=outcome.curve,
        facts={
            "protocol": str(scores["protocol"]),
            "device": str(scores["device"]),
            "held-out views": str(scores["views"]),
            "background": str(scores["background"]),
            "size": f"{scores['bytes']:,} bytes, {8 * scores['bytes'] / max(anchors, 1):.1f} bits "
            "per anchor",
        },
    )


def print_box(outcome: Outcome, out: Path, target: Target | None) -> None:
    """The last thing on the screen."""
    from rich.console import Console
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    misses = target.misses(outcome) if target else []
    table = Table.grid(padding=(0, 2))
    for name, value in box_rows(outcome, out):
        table.add_row(Text(name, style="dim"), Text(value))
    for miss in misses:
        table.add_row(Text("missed", style="bold red"), Text(miss, style="red"))
    title = "short of its target" if misses else "done"
    style = "red" if misses else "green"
    Console().print(Panel(table, title=f"clgs demo: {title}", border_style=style, expand=False))


def box_rows(outcome: Outcome, out: Path) -> list[tuple[str, str]]:
    """Labels and values of the box."""
    scores = outcome.scores
    stages = "  ".join(f"{name} {seconds:.1f}" for name, seconds in outcome.seconds.items())
    return [
        ("photos", f"{outcome.registered} of {outcome.photos} registered"),
        ("PSNR", f"{scores['psnr']:.2f} dB on {scores['views']} held-out views, decoded file"),
        ("SSIM", f"{scores['ssim']:.4f}"),
        ("bytes", f"{scores['bytes']:,} for {scores['anchors']:,} anchors"),
        ("seconds", f"{outcome.total_seconds:.1f}:  {stages}"),
        ("look at", f"{out / PAGE}"),
        ("", f"{out / PICTURE}"),
    ]
