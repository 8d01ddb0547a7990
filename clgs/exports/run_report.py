"""The page about a training run, from the files of its folder."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.codec.scene_decoder import describe
from clgs.errors import DataError
from clgs.exports.image import picture_names
from clgs.exports.report import Report, ReportView, report_html
from clgs.files import atomic_write

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


def write_run_report(
    folder: Path,
    command: str = "",
    lead: str = "",
    seconds: Mapping[str, float] | None = None,
    links: Sequence[tuple[str, str]] = (),
    page: Path | None = None,
    title: str = "",
) -> Path:
    """Write the page about the finished run in ``folder``.

    The page tells the ``command`` that repeats the run, the ``seconds`` of each stage, by default
    of training alone, and ``links``: (label, file in the page's folder). ``lead`` is its first
    sentence, ``title`` the scene's name, by default that of ``folder``. Its path, by default REPORT
    in ``folder``, is returned.

    Raises:
        DataError: a file of the run is missing or damaged.
        OSError: the page cannot be written.
    """
    path = page or folder / REPORT
    try:
        summary = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        scores = json.loads((folder / "per_view.json").read_text(encoding="utf-8"))
        pictures = folder / "test" / f"ours_{summary['steps']}"
        names = picture_names([score["name"] for score in scores])
        views = [
            ReportView(score["name"], score["psnr"], score["ssim"], partial(_pair, pictures, name))
            for score, name in zip(scores, names, strict=True)
        ]
        held_out, anchors = summary["split"] == "test", int(summary["anchors"])
        in_training = [summary["train_psnr"]] if held_out else []
        bits = 8 * summary["bytes"] / max(anchors, 1)
        report = Report(
            title=title or folder.resolve().name,
            lead=lead,
            headline=[
                ("PSNR, held out" if held_out else "PSNR in training", f"{summary['psnr']:.2f} dB"),
                *(("PSNR in training", f"{psnr:.2f} dB") for psnr in in_training),
                ("SSIM", f"{summary['ssim']:.4f}"),
                ("scene.clgs", f"{summary['bytes'] / 2**10:,.0f} KiB"),
                ("anchors", f"{anchors:,}"),
                ("seconds", f"{sum((seconds or {}).values()) or summary['train_seconds']:,.0f}"),
            ],
            sections=sections(folder),
            seconds=seconds or {},
            curve=read_curve(folder / "progress.csv"),
            facts={
                **({"command": command} if command else {}),
                "steps": f"{summary['steps']:,}",
                f"{'held-out' if held_out else 'training'} views": str(summary["views"]),
                "size": f"{summary['bytes']:,} bytes, {bits:.1f} bits per anchor",
                "device": str(summary["device"]),
                "background": str(summary["background"]),
                "protocol": str(summary["protocol"]),
                "the curve": "PSNR of a few training views; the figures above are of whole sets",
            },
            held_out=held_out,
            links=links,
        )
        atomic_write(path, report_html(report, views).encode(errors="backslashreplace"))
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


def _pair(pictures: Path, name: str) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Photo and render of a view, from the PNG files of the run."""
    from PIL import Image

    def read(path: Path) -> npt.NDArray[np.uint8]:
        with Image.open(path) as picture:
            return np.array(picture.convert("RGB"))

    return read(pictures / "gt" / name), read(pictures / "renders" / name)
