"""An HTML page about camera poses: figures, cameras and points from two sides, every photo.

Like the report of a run the page needs no script and loads nothing.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from clgs.data.colmap.model import read_colmap
from clgs.data.posed_photo import Photo, PhotoSet
from clgs.exports.plan import plan
from clgs.exports.report import STYLE, cards
from clgs.files import atomic_write
from clgs.poses.judging.verdict import DOUBTFUL, GOOD, LEFT_OUT, PhotoVerdict, Verdict
from clgs.poses.report import CELL, COLUMNS, CONTACT_SHEET

OWN_STYLE = """\
.good { --status: #2e8b57; } .doubtful { --status: #d98200; } .left { --status: #c53030; }
.plan .camera { fill: none; stroke: var(--status); stroke-width: 1.6; }
.plan .points { stroke: var(--soft); stroke-width: 1.4; stroke-linecap: round; opacity: .55; }
.sheet { display: grid; grid-template-columns: repeat(auto-fill, minmax(160px, 1fr)); gap: .7rem; }
.sheet figure { margin: 0; } .sheet figcaption { overflow-wrap: anywhere; }
.thumb { width: 160px; height: 120px; border: 3px solid var(--status); border-radius: .3rem;
  background-image: var(--photos); }
.status { color: var(--status); font-weight: 600; }
"""

_CLASS = {GOOD: "good", DOUBTFUL: "doubtful", LEFT_OUT: "left"}


def write_poses_page(path: Path, data: Path, verdict: Verdict) -> None:
    """Write the page on what ``clgs.prepare`` made in the folder ``data``: the whole file or none.

    Raises:
        DataError: the folder is damaged.
        OSError: the page cannot be written.
    """
    photos = read_colmap(data, data / "sparse" / "0")
    atomic_write(path, poses_html(photos, verdict, (data / CONTACT_SHEET).read_bytes()).encode())


def poses_html(photos: PhotoSet, verdict: Verdict, sheet: bytes) -> str:
    """The page as text; sheet: the contact sheet's bytes."""
    picture = base64.b64encode(sheet).decode()
    body = "\n".join(
        (
            "<h1>Camera poses</h1>",
            f"<p>{escape(verdict.sure)}.</p>",
            cards(_headline(verdict)),
            _plans(photos, verdict),
            _table([*verdict.of(LEFT_OUT), *verdict.of(DOUBTFUL)]),
            _sheet(verdict.photos),
            _facts(verdict),
        )
    )
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>Camera poses</title>\n<style>\n{STYLE}{OWN_STYLE}"
        f".sheet {{ --photos: url(data:image/jpeg;base64,{picture}); }}\n</style>\n</head>\n"
        f"<body>\n{body}\n</body>\n</html>\n"
    )


def _headline(verdict: Verdict) -> list[tuple[str, str]]:
    return [
        ("photos with a pose", f"{verdict.registered} / {verdict.total}"),
        ("doubtful", str(len(verdict.of(DOUBTFUL)))),
        ("points", f"{verdict.points:,}"),
        ("reprojection error", f"{verdict.error:.2f} px"),
        ("track length", f"{verdict.track_length:.1f}"),
    ]


def _plans(photos: PhotoSet, verdict: Verdict) -> str:
    """Cameras and points from above and from the side."""
    posed = sorted([*photos.train, *photos.test], key=lambda photo: photo.name)
    if photos.points is None or not posed:
        return ""
    status = {one.name: _CLASS[one.status] for one in verdict.photos}
    marks = [(photo, status.get(photo.name, "good")) for photo in posed]
    views = zip(("from above", "from the side"), _axes(posed), strict=True)
    figures = "".join(
        f"<figure>{plan(marks, photos.points, axes)}<figcaption>{text}</figcaption></figure>"
        for text, axes in views
    )
    legend = "Cameras look along their open side: green good, orange doubtful."
    return (
        f'<section><h2>Cameras and points</h2><p class="soft">{legend}</p>'
        f'<div class="pair">{figures}</div></section>'
    )


def _axes(photos: Sequence[Photo]) -> list[np.ndarray]:
    """Rows right and down (2, 3) of a view along the cameras' mean down-vector, and across it."""
    down = np.mean([photo.rotation[1] for photo in photos], axis=0)
    down /= max(float(np.linalg.norm(down)), 1e-12)
    across = np.mean([photo.rotation[0] for photo in photos[:1]], axis=0)
    right = across - (across @ down) * down
    right /= max(float(np.linalg.norm(right)), 1e-12)
    return [np.stack([right, np.cross(right, down)]), np.stack([right, down])]


def _table(photos: Sequence[PhotoVerdict]) -> str:
    if not photos:
        return ""
    rows = "".join(
        f'<tr><td>{escape(one.name)}</td><td class="{_CLASS[one.status]}">'
        f'<span class="status">{one.status}</span></td>'
        f"<td>{escape('; '.join(one.reasons))}</td><td>{escape(one.remedy)}</td></tr>"
        for one in photos
    )
    head = "<tr><th>photo</th><th></th><th>why</th><th>remedy</th></tr>"
    return f"<section><h2>Not certain</h2><table>{head}{rows}</table></section>"


def _sheet(photos: Sequence[PhotoVerdict]) -> str:
    """Every photo, its frame in the colour of its verdict."""
    width, height = CELL
    figures = []
    for number, one in enumerate(photos):
        row, column = divmod(number, COLUMNS)
        style = f"background-position: {-column * width}px {-row * height}px"
        figures.append(
            f'<figure class="{_CLASS[one.status]}"><div class="thumb" style="{style}"></div>'
            f"<figcaption>{escape(one.name)}<br>{escape(_figures(one))}</figcaption></figure>"
        )
    return f'<section><h2>Photos</h2><div class="sheet">{"".join(figures)}</div></section>'


def _figures(one: PhotoVerdict) -> str:
    if one.inlier_ratio is None:
        return one.status
    parts = [f"{one.observations:,} points", f"{100 * one.inlier_ratio:.0f} % inliers"]
    if one.turn is not None:
        parts.append(f"±{one.turn:.2f}°")
    return ", ".join(parts)


def _facts(verdict: Verdict) -> str:
    facts = {"mapper kept": verdict.mapper}
    facts |= {f"matches explained, {name}": f"{n:,}" for name, n in verdict.explained.items()}
    facts["matches in links that contradict the poses"] = f"{100 * verdict.contradicted:.1f} %"
    facts |= {
        f"other model {number}": f"{len(names)} photos: {', '.join(names)}"
        for number, names in enumerate(verdict.apart, 1)
    }
    facts |= {f"seconds, {stage}": f"{value:.1f}" for stage, value in verdict.seconds.items()}
    rows = "".join(f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in facts.items())
    return f"<section><h2>Conditions</h2><table>{rows}</table></section>"
