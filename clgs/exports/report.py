"""One self-contained HTML page about a run: scores, bytes, seconds, training curve, pictures.

It is made from the files of the run's folder. The page needs no script and loads nothing: styles,
charts (SVG) and pictures (JPEG) are inside. Every text goes through ``html.escape``.
"""

from __future__ import annotations

import base64
import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from html import escape
from pathlib import Path
from urllib.parse import quote

import numpy as np
import numpy.typing as npt

from clgs.codec.scene_decoder import describe
from clgs.errors import DataError
from clgs.exports.pictures import ERROR_GAIN, error_map, jpeg_bytes, picture_names
from clgs.files import atomic_write, text_bytes

MOST_PICTURES = 12
"""Views whose pictures are in the page."""

STYLE = """\
:root { color-scheme: light dark; --ink: #1c2430; --soft: #667085; --line: #e3e6ec;
  --page: #ffffff; --card: #f6f7f9; --mark: #2f6fb0; }
@media (prefers-color-scheme: dark) { :root { --ink: #e7eaf0; --soft: #98a2b3; --line: #303846;
  --page: #12161d; --card: #1a202a; --mark: #6fa8dc; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2rem 1.1rem 4rem; max-width: 62rem; background: var(--page);
  color: var(--ink); font: 16px/1.55 system-ui, "Segoe UI", "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .4rem; }
h2 { font-size: 1.1rem; margin: 2.6rem 0 .8rem; }
p { margin: 0 0 1rem; max-width: 44rem; } .soft, figcaption, th { color: var(--soft); }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(9rem, 1fr)); gap: .7rem;
  margin: 1.6rem 0 0; padding: 0; }
.cards div { background: var(--card); border-radius: .5rem; padding: .8rem 1rem; }
.cards dt { color: var(--soft); font-size: .85rem; }
.cards dd { margin: 0; font-size: 1.3rem; font-weight: 600; white-space: nowrap;
  font-variant-numeric: tabular-nums; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 24rem), 1fr));
  gap: 0 2.4rem; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th { font-weight: 500; text-align: left; font-size: .85rem; }
td, th { padding: .35rem .7rem .35rem 0; border-bottom: 1px solid var(--line); }
td.number, th.number { text-align: right; white-space: nowrap; }
td.bar { width: 36%; padding-right: 0; } td.bar svg { display: block; width: 100%; height: .7rem; }
rect, .curve { fill: var(--mark); } .curve { fill: none; stroke: var(--mark); stroke-width: 2.5; }
.chart { width: 100%; height: auto; } .chart line { stroke: var(--line); }
.chart text { fill: var(--soft); font-size: 13px; }
figure { margin: 0 0 1.6rem; } figure div { display: flex; gap: .3rem; }
label { flex: 1; min-width: 0; cursor: zoom-in; } label input { position: absolute; opacity: 0; }
label img { display: block; width: 100%; border-radius: .3rem; }
label input:focus-visible + img { outline: 2px solid var(--mark); }
label input:checked + img { position: fixed; inset: 0; z-index: 1; width: 100%; height: 100%;
  object-fit: contain; background: #000e; border-radius: 0; cursor: zoom-out; }
code { font-size: .9rem; overflow-wrap: anywhere; }
figcaption { font-size: .9rem; padding-top: .3rem; }
"""


@dataclass(frozen=True)
class ReportView:
    """A view: its name, scores, and what reads its photo and render, both (H, W, 3) uint8."""

    name: str
    psnr: float
    ssim: float
    pictures: Callable[[], tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]]


@dataclass(frozen=True)
class Report:
    """What the page tells.

    headline: (label, value) of the large figures; sections: bytes of the file by section;
    seconds: by stage; curve: (step, PSNR in dB) while training; facts: small print; held_out:
    whether training never saw the views; links: (label, file in the page's folder).
    """

    title: str
    lead: str
    headline: Sequence[tuple[str, str]]
    sections: Mapping[str, int] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    curve: Sequence[tuple[int, float]] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    held_out: bool = True
    links: Sequence[tuple[str, str]] = ()


def report_html(report: Report, views: Sequence[ReportView]) -> str:
    """The page as text."""
    named = (f'<a href="{escape(quote(file))}">{escape(label)}</a>' for label, file in report.links)
    parts = [
        f"<h1>{escape(report.title)}</h1>",
        f'<p class="soft">{escape(report.lead)}</p>',
        f"<p>{' · '.join(named)}</p>" if report.links else "",
        _pictures(shown(views), report.held_out),
        cards(report.headline),
        _scores(views),
        _curve(report.curve),
        '<div class="pair">',
        _bars("Seconds by stage", report.seconds, "{:,.1f}", "s"),
        _bars("Bytes by section", report.sections, "{:,.0f}", "bytes"),
        "</div>",
        facts_table(report.facts),
    ]
    return html_page(report.title, "\n".join(part for part in parts if part))


def html_page(title: str, body: str, style: str = "") -> str:
    """A whole page; ``style`` is added to STYLE."""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{STYLE}{style}</style>\n</head>\n"
        f"<body>\n{body}\n</body>\n</html>\n"
    )


def shown(views: Sequence[ReportView]) -> list[ReportView]:
    """The views whose pictures a page shows: all, or a few from the worst to the best."""
    if len(views) <= MOST_PICTURES:
        return list(views)
    ranked = sorted(views, key=lambda view: view.psnr)
    return [ranked[i] for i in np.linspace(0, len(ranked) - 1, MOST_PICTURES).round().astype(int)]


def cards(headline: Sequence[tuple[str, str]]) -> str:
    """Large figures with their labels."""
    inner = "".join(
        f"<div><dt>{escape(label)}</dt><dd>{escape(value)}</dd></div>" for label, value in headline
    )
    return f'<dl class="cards">{inner}</dl>'


def _bars(title: str, values: Mapping[str, float], form: str, unit: str) -> str:
    """A table whose last column draws each value as a share of the largest."""
    if not values:
        return ""
    largest, total = max(values.values()), sum(values.values())
    rows = []
    for name, value in values.items():
        share = 100 * value / largest if largest > 0 else 0.0
        rows.append(
            f'<tr><td>{escape(name)}</td><td class="number">{form.format(value)}</td>'
            '<td class="bar"><svg viewBox="0 0 100 8" preserveAspectRatio="none">'
            f'<rect width="{share:.2f}" height="8"/></svg></td></tr>'
        )
    head = f'<tr><th></th><th class="number">{escape(unit)}</th><th></th></tr>'
    foot = f'<tr><th>total</th><th class="number">{form.format(total)}</th><th></th></tr>'
    return f"<section><h2>{escape(title)}</h2><table>{head}{''.join(rows)}{foot}</table></section>"


def _curve(curve: Sequence[tuple[int, float]]) -> str:
    """PSNR over steps as a line chart with a few round grid lines."""
    points = [(step, psnr) for step, psnr in curve if np.isfinite(psnr)]
    if len(points) < 2:
        return ""
    width, height, left, top, bottom = 720, 260, 44, 12, 30
    last = max(step for step, _ in points)
    least, most = min(p for _, p in points), max(p for _, p in points)
    # three to seven round numbers, the first below and the last above all
    apart = next(
        a for a in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 1e9) if (most - least) / a <= 5
    )
    first = int(np.floor(least / apart))
    ticks = [apart * n for n in range(first, max(int(np.ceil(most / apart)), first + 1) + 1)]
    low, high = ticks[0], ticks[-1]

    def x(step: float) -> float:
        return left + (width - left - 12) * step / last

    def y(psnr: float) -> float:
        return top + (height - top - bottom) * (high - psnr) / (high - low)

    line = " ".join(f"{x(step):.1f},{y(psnr):.1f}" for step, psnr in points)
    rules = "".join(
        f'<line x1="{left}" x2="{width - 12}" y1="{y(tick):.1f}" y2="{y(tick):.1f}"/>'
        f'<text x="{left - 8}" y="{y(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>'
        for tick in ticks
    )
    steps = "".join(
        f'<text x="{x(step):.1f}" y="{height - 8}" text-anchor="{anchor}">{label}</text>'
        for step, anchor, label in (
            (0, "start", "0"),
            (last / 2, "middle", f"{last // 2:,}"),
            (last, "end", f"{last:,} steps"),
        )
    )
    return (
        f'<section><h2>PSNR while training (dB)</h2><svg class="chart" role="img" '
        f'viewBox="0 0 {width} {height}" aria-label="PSNR over steps">{rules}{steps}'
        f'<polyline class="curve" points="{line}"/></svg></section>'
    )


def _pictures(views: Sequence[ReportView], held_out: bool) -> str:
    if not views:
        return ""
    figures = []
    for view in views:
        caption = f"{view.name}: {view.psnr:.2f} dB, SSIM {view.ssim:.4f}"
        photo, render = view.pictures()
        trio = (("photo", photo), ("render", render), ("error", error_map(photo, render)))
        # a picture fills the window while its hidden box is checked: no script is needed
        images = "".join(
            '<label><input type="checkbox" aria-label="enlarge">'
            f'<img alt="{escape(f"{name} of {view.name}")}" src="data:image/jpeg;base64,'
            f'{base64.b64encode(jpeg_bytes(picture)).decode()}"></label>'
            for name, picture in trio
        )
        figures.append(
            f"<figure><div>{images}</div><figcaption>{escape(caption)}</figcaption></figure>"
        )
    text = (
        f"Left the photo{', which training never saw' * held_out}; in the middle the render from "
        f"the decoded file; right their difference, magnified {ERROR_GAIN:g} times. Click to "
        "enlarge."
    )
    title = "Held-out views" if held_out else "Training views"
    return f'<section><h2>{title}</h2><p class="soft">{text}</p>{"".join(figures)}</section>'


def _scores(views: Sequence[ReportView]) -> str:
    if not views:
        return ""
    rows = "".join(
        f'<tr><td>{escape(view.name)}</td><td class="number">{view.psnr:.2f}</td>'
        f'<td class="number">{view.ssim:.4f}</td></tr>'
        for view in views
    )
    head = '<tr><th>view</th><th class="number">PSNR, dB</th><th class="number">SSIM</th></tr>'
    return f"<section><h2>Scores by view</h2><table>{head}{rows}</table></section>"


def facts_table(facts: Mapping[str, str]) -> str:
    """The small print, (name, text); nothing if there is none."""
    if not facts:
        return ""
    rows = "".join(f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in facts.items())
    return f"<section><h2>Conditions</h2><table>{rows}</table></section>"


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
        atomic_write(path, text_bytes(report_html(report, views)))
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
