"""The page about a training run, from the files of its folder."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.codec.scene_decoder import describe
from clgs.errors import DataError
from clgs.exports.image import picture_names
from clgs.exports.report import Report, ReportView, write_report

REPORT = "report.html"

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
class RunStory:
    """What the files of a run do not say.

    command: the one that repeats it; lead: the first sentence of the page; seconds: by
    stage; links: (label, file in the page's folder).
    """

    command: str = ""
    lead: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)
    links: Sequence[tuple[str, str]] = ()


def write_run_report(folder: Path, story: RunStory, page: Path | None = None) -> Path:
    """Write ``page``, by default REPORT in the run's ``folder``; the path of the page.

    Raises:
        DataError: a file of the run is missing or damaged.
        OSError: the page cannot be written.
    """
    try:
        summary = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        scores = json.loads((folder / "per_view.json").read_text(encoding="utf-8"))
        report = make_report(summary, story, sections(folder), read_curve(folder / "progress.csv"))
        path = page or folder / REPORT
        write_report(path, report, _views(folder, summary, scores))
    except (ValueError, KeyError, TypeError, FileNotFoundError) as error:
        raise DataError(f"{folder}: is no whole run ({error}); train it again") from error
    return path


def sections(folder: Path) -> dict[str, int]:
    """Bytes by section, in words, of the run's scene.clgs."""
    found = describe((folder / "scene.clgs").read_bytes())["sections"]
    return {SECTIONS.get(tag, tag): int(size) for tag, size in found.items()}


def read_curve(path: Path) -> list[tuple[int, float]]:
    """(step, PSNR) of the regular rows of progress.csv; rows of single events are left out."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["psnr"] and not row["event"]]
    return [(int(row["step"]), float(row["psnr"])) for row in rows]


def make_report(
    summary: Mapping[str, Any],
    story: RunStory,
    parts: Mapping[str, int],
    curve: Sequence[tuple[int, float]],
) -> Report:
    """The page's content, of results.json, the bytes by section and the curve."""
    held_out, anchors = summary["split"] == "test", int(summary["anchors"])
    trained = [summary["train_psnr"]] if held_out else []
    return Report(
        title="From photos to one compressed file and back",
        lead=story.lead,
        headline=[
            ("PSNR, held out" if held_out else "PSNR in training", f"{summary['psnr']:.2f} dB"),
            *(("PSNR in training", f"{psnr:.2f} dB") for psnr in trained),
            ("SSIM", f"{summary['ssim']:.4f}"),
            ("scene.clgs", f"{summary['bytes'] / 2**10:,.0f} KiB"),
            ("anchors", f"{anchors:,}"),
            ("seconds", f"{sum(story.seconds.values()) or summary['train_seconds']:,.0f}"),
        ],
        sections=parts,
        seconds=story.seconds,
        curve=curve,
        facts=_facts(summary, story, anchors),
        held_out=held_out,
        links=story.links,
    )


def _facts(summary: Mapping[str, Any], story: RunStory, anchors: int) -> dict[str, str]:
    bits = 8 * summary["bytes"] / max(anchors, 1)
    views = "held-out" if summary["split"] == "test" else "training"
    return {
        **({"command": story.command} if story.command else {}),
        "steps": f"{summary['steps']:,}",
        f"{views} views": str(summary["views"]),
        "size": f"{summary['bytes']:,} bytes, {bits:.1f} bits per anchor",
        "device": str(summary["device"]),
        "background": str(summary["background"]),
        "protocol": str(summary["protocol"]),
        "the curve": "PSNR of a few training views; the figures above are of whole sets",
    }


def _views(
    folder: Path, summary: Mapping[str, Any], scores: list[dict[str, Any]]
) -> list[ReportView]:
    """Every scored view; its pictures are the PNG files of the run, read if they are shown."""
    pictures = folder / "test" / f"ours_{summary['steps']}"
    names = picture_names([score["name"] for score in scores])
    return [
        ReportView(score["name"], score["psnr"], score["ssim"], partial(_pair, pictures, name))
        for score, name in zip(scores, names, strict=True)
    ]


def _pair(pictures: Path, name: str) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    return _read(pictures / "gt" / name), _read(pictures / "renders" / name)


def _read(path: Path) -> npt.NDArray[np.uint8]:
    from PIL import Image

    with Image.open(path) as picture:
        return np.array(picture.convert("RGB"))
