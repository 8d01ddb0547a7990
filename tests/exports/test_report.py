import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from clgs.exports.report import Report, ReportView, report_html

PICTURE = np.random.default_rng(2).integers(0, 256, (12, 40, 3), dtype=np.uint8)


def pair():
    return PICTURE, PICTURE


VIEWS = [ReportView("one.jpg", 26.125, 0.91234, pair), ReportView("two.jpg", 30.0, 0.95, pair)]
REPORT = Report(
    title="A title",
    lead="A sentence.",
    headline=[("PSNR", "28.1 dB")],
    sections={"positions": 1500, "features": 3000},
    seconds={"train": 120.0, "encode": 0.5},
    curve=[(0, 11.0), (100, 20.0), (200, 24.5)],
    facts={"device": "a device"},
)
VOID = {"meta", "img", "input", "rect", "line", "polyline", "!doctype"}


class Balance(HTMLParser):
    """Every tag that opens closes, in order; collects texts and attributes."""

    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.open, self.texts, self.attributes = [], [], []

    def handle_starttag(self, tag, attributes):
        self.attributes += attributes
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.attributes += attributes

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def parse(page):
    parser = Balance()
    parser.feed(page)
    parser.close()
    assert not parser.open
    return parser


def test_page_is_well_formed_and_tells_everything():
    text = " ".join(parse(report_html(REPORT, VIEWS)).texts)
    for part in ("A title", "28.1 dB", "1,500", "4,500", "120.5", "26.12", "0.9500", "a device"):
        assert part in text


def test_page_loads_nothing_and_runs_nothing():
    page = report_html(REPORT, VIEWS)
    assert "<script" not in page
    assert "url(" not in page
    assert "@import" not in page
    links = [value for name, value in parse(page).attributes if name in {"src", "href"}]
    assert len(links) == 2 * 3
    assert all(link.startswith("data:image/jpeg;base64,") for link in links)
    assert not re.search(r"https?://", page)


def test_pictures_are_inside():
    link = dict(parse(report_html(REPORT, VIEWS[:1])).attributes)["src"]
    data = base64.b64decode(link.split(",", 1)[1], validate=True)
    with Image.open(io.BytesIO(data)) as picture:
        assert picture.size == (40, 12)


@given(st.text(alphabet="<>&\"'/abc\n é", max_size=12))
def test_every_text_is_escaped(text):
    hostile = text + "<script>\"'&</style>"
    report = Report(
        hostile, hostile, [(hostile, hostile)], {hostile: 1}, {hostile: 1.0}, [], {hostile: hostile}
    )
    page = report_html(report, [ReportView(hostile, 1.0, 1.0, pair)])
    assert "<script" not in page
    assert page.count("</style>") == 1
    texts = parse(page).texts
    # title and h1, lead, card 2, sections, seconds, caption, scores, facts 2; alt is an attribute
    assert sum(hostile in part for part in texts) == 11


def test_bars_are_shares_of_the_largest():
    page = report_html(REPORT, [])
    assert re.findall(r'<rect width="([\d.]+)"', page) == ["100.00", "0.42", "50.00", "100.00"]


def test_curve_spans_the_chart_and_skips_what_is_no_number():
    curve = [(0, 11.0), (100, float("nan")), (200, 24.5)]
    report = Report("t", "l", [], curve=curve)
    (points,) = re.findall(r'points="([^"]+)"', report_html(report, []))
    pairs = np.array([[float(n) for n in pair.split(",")] for pair in points.split()])
    assert len(pairs) == 2
    assert pairs[0, 0] == 44
    assert pairs[1, 0] == 708
    assert pairs[1, 1] < pairs[0, 1]


@pytest.mark.parametrize("curve", [[], [(0, 12.0)], [(5, float("inf")), (6, float("nan"))]])
def test_curve_of_too_few_points_is_left_out(curve):
    assert "<polyline" not in report_html(Report("t", "l", [], curve=curve), [])


@given(st.floats(-20, 90, allow_nan=False), st.floats(0, 60, allow_nan=False))
def test_curve_stays_inside_the_chart(low, rise):
    page = report_html(Report("t", "l", [], curve=[(0, low), (10, low + rise)]), [])
    (points,) = re.findall(r'points="([^"]+)"', page)
    heights = [float(pair.split(",")[1]) for pair in points.split()]
    assert all(12 <= height <= 230 for height in heights)


def test_empty_parts_are_left_out():
    page = report_html(Report("t", "l", []), [])
    parse(page)
    assert "<h2>" not in page
