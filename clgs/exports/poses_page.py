"""An HTML page about camera poses: figures, cameras and points from two sides, every photo.

Like the report of a run the page needs no script and loads nothing.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.data.colmap_model import read_colmap
from clgs.data.posed_photo import Photo, PhotoSet
from clgs.exports.report import cards, facts_table, html_page
from clgs.files import atomic_write, text_bytes
from clgs.poses.prepare import CELL, COLUMNS, CONTACT_SHEET
from clgs.poses.verdict import DOUBTFUL, GOOD, LEFT_OUT, PhotoVerdict, Verdict

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

MAP_SIZE = 480
"""Width and height of the drawing, pixels."""

MAX_POINTS = 4000
KEPT = 0.9
"""Share of the points that the drawing must hold; those far away are cut off."""

CAMERA = 0.035
"""Length of a camera, of the drawing's width."""

Floats = npt.NDArray[np.float64]

_CLASS = {GOOD: "good", DOUBTFUL: "doubtful", LEFT_OUT: "left"}


def write_poses_page(path: Path, data: Path, verdict: Verdict) -> None:
    """Write the page about the data set ``data`` that ``clgs.prepare`` made, whole or not at all.

    Raises:
        DataError: the folder is damaged.
        OSError: the page cannot be written.
    """
    photos = read_colmap(data, data / "sparse" / "0")
    page = poses_html(photos, verdict, (data / CONTACT_SHEET).read_bytes())
    atomic_write(path, text_bytes(page))


def poses_html(photos: PhotoSet, verdict: Verdict, sheet: bytes) -> str:
    """Make the page as text; ``photos`` have the poses that were found, ``sheet`` is a JPEG."""
    picture = base64.b64encode(sheet).decode()
    facts = {"mapper kept": verdict.mapper}
    facts |= {f"matches explained, {name}": f"{n:,}" for name, n in verdict.explained.items()}
    facts["matches in links that contradict the poses"] = f"{100 * verdict.contradicted:.1f} %"
    facts |= {
        f"other model {number}": f"{len(names)} photos: {', '.join(names)}"
        for number, names in enumerate(verdict.apart, 1)
    }
    facts |= {f"seconds, {stage}": f"{value:.1f}" for stage, value in verdict.seconds.items()}
    headline = [
        ("photos with a pose", f"{verdict.registered} / {verdict.total}"),
        ("doubtful", str(len(verdict.of(DOUBTFUL)))),
        ("points", f"{verdict.points:,}"),
        ("reprojection error", f"{verdict.error:.2f} px"),
        ("track length", f"{verdict.track_length:.1f}"),
    ]
    body = "\n".join(
        (
            "<h1>Camera poses</h1>",
            f"<p>{escape(verdict.sure)}.</p>",
            *(f"<p>{escape(note)}.</p>" for note in verdict.notes),
            cards(headline),
            _maps(photos, verdict),
            _table([*verdict.of(LEFT_OUT), *verdict.of(DOUBTFUL)]),
            _sheet(verdict.photos),
            facts_table(facts),
        )
    )
    style = f"{OWN_STYLE}.sheet {{ --photos: url(data:image/jpeg;base64,{picture}); }}\n"
    return html_page("Camera poses", body, style)


def _maps(photos: PhotoSet, verdict: Verdict) -> str:
    """Draw cameras and points from above and from the side: along and across the mean "down"."""
    posed = sorted([*photos.train, *photos.test], key=lambda photo: photo.name)
    if photos.points is None or not posed:
        return ""
    status = {one.name: _CLASS[one.status] for one in verdict.photos}
    marks = [(photo, status.get(photo.name, "good")) for photo in posed]
    down = np.mean([photo.rotation[1] for photo in posed], axis=0)
    down /= max(float(np.linalg.norm(down)), 1e-12)
    across = posed[0].rotation[0]
    right = across - (across @ down) * down
    right /= max(float(np.linalg.norm(right)), 1e-12)
    views = {"from above": [right, np.cross(right, down)], "from the side": [right, down]}
    figures = "".join(
        f"<figure>{_draw_map(marks, photos.points, np.stack(axes))}"
        f"<figcaption>{text}</figcaption></figure>"
        for text, axes in views.items()
    )
    legend = "Cameras look along their open side: green good, orange doubtful."
    return (
        f'<section><h2>Cameras and points</h2><p class="soft">{legend}</p>'
        f'<div class="pair">{figures}</div></section>'
    )


def _draw_map(photos: Sequence[tuple[Photo, str]], points: Floats, axes: Floats) -> str:
    """Draw photos, each with the class of its mark, and points (P, 3) in world units, as SVG.

    axes: (2, 3), the directions to the right and down, unit.
    """
    centres = np.array([photo.centre for photo, _ in photos]) @ axes.T
    flat = points[:: max(1, len(points) // MAX_POINTS)] @ axes.T
    low, size = _frame(centres, flat)
    scale = MAP_SIZE / size
    dots = (flat - low) * scale
    inside = dots[((dots >= 0) & (dots <= MAP_SIZE)).all(1)]
    path = "".join(f"M{x:.0f} {y:.0f}h0" for x, y in inside)
    marks = "".join(
        _mark(photo, kind, (centre - low) * scale, axes)
        for (photo, kind), centre in zip(photos, centres, strict=True)
    )
    return (
        f'<svg class="chart plan" role="img" viewBox="0 0 {MAP_SIZE} {MAP_SIZE}" '
        f'aria-label="cameras and points"><path class="points" d="{path}"/>{marks}</svg>'
    )


def _frame(centres: Floats, points: Floats) -> tuple[Floats, float]:
    """Upper left corner (2,) and width of a square that holds all cameras and most points."""
    lower, upper = centres.min(0), centres.max(0)
    if len(points):
        tail = (1 - KEPT) / 2
        lower = np.minimum(lower, np.quantile(points, tail, axis=0))
        upper = np.maximum(upper, np.quantile(points, 1 - tail, axis=0))
    size = 1.1 * max(float((upper - lower).max()), 1e-12)
    return np.asarray((lower + upper - size) / 2), size


def _mark(photo: Photo, kind: str, centre: Floats, axes: Floats) -> str:
    """A triangle that opens where the camera looks."""
    forward, aside = axes @ photo.rotation[2], axes @ photo.rotation[0]
    length = CAMERA * MAP_SIZE
    half = 0.5 * photo.lens.width / photo.lens.fx
    corners = [centre, *(centre + length * (forward + side * half * aside) for side in (-1, 1))]
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    title = f"<title>{escape(photo.name)}</title>"
    return f'<polygon class="camera {kind}" points="{text}">{title}</polygon>'


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
    """Show every photo in a frame of the colour of its verdict, with its figures."""
    width, height = CELL
    figures = []
    for number, one in enumerate(photos):
        row, column = divmod(number, COLUMNS)
        style = f"background-position: {-column * width}px {-row * height}px"
        text = one.status
        if one.inlier_ratio is not None:
            text = f"{one.observations:,} points, {100 * one.inlier_ratio:.0f} % inliers"
            text += f", ±{one.turn:.2f}°" if one.turn is not None else ""
        figures.append(
            f'<figure class="{_CLASS[one.status]}"><div class="thumb" style="{style}"></div>'
            f"<figcaption>{escape(one.name)}<br>{escape(text)}</figcaption></figure>"
        )
    return f'<section><h2>Photos</h2><div class="sheet">{"".join(figures)}</div></section>'
