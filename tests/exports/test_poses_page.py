"""The page about camera poses: everything is there, and nothing is taken for markup."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from PIL import Image

from clgs.data.lens import Lens
from clgs.data.posed_photo import Photo, PhotoSet
from clgs.exports.poses_page import poses_html
from clgs.poses.prepare import CELL, COLUMNS, contact_sheet
from clgs.poses.verdict import DOUBTFUL, GOOD, LEFT_OUT, PhotoVerdict, Verdict
from tests.data.folders import ring, write_noise

NAMES = ["a.jpg", "b & <b>.jpg", "c.jpg"]


def test_the_page_tells_all_and_escapes_names(tmp_path: Path):
    placed = []
    for name, pose in zip(NAMES[:2], ring(2), strict=True):
        inverse = np.linalg.inv(pose)
        lens = Lens(40, 30, 50.0, 50.0, 20.0, 15.0)
        placed.append(Photo(name, Path(name), lens, inverse[:3, :3], inverse[:3, 3]))
    points = np.random.default_rng(0).normal(size=(500, 3))
    photos = (
        PhotoVerdict(NAMES[0], GOOD, 900, 0.98, 4.0, 0.5, 3.0, 8.0, 0.02, 0.03),
        PhotoVerdict(NAMES[1], DOUBTFUL, 40, 0.4, reasons=("few <points>",), remedy="more & more"),
        PhotoVerdict(NAMES[2], LEFT_OUT, reasons=("it shares too little",), remedy="remove it"),
    )
    counts, apart = {"incremental": 12345, "global": 12000}, (("c.jpg",),)
    figures = 2, 3, 500, 940, 0.52, 3.7, "incremental", counts, apart
    verdict = Verdict(*figures, photos, True, False, 0.02, "ok")
    files = sorted(write_noise(tmp_path, 3, (64, 48)).iterdir())
    page = poses_html(PhotoSet("colmap", placed, [], [], points), verdict, contact_sheet(files))
    for text in ("2 / 3", "0.52 px", "12,345", "900 points", "it shares too little", "c.jpg"):
        assert text in page
    assert "<b>" not in page
    assert "b &amp; &lt;b&gt;.jpg" in page
    assert "few &lt;points&gt;" in page
    assert page.count('class="thumb"') == 3
    assert page.count("<polygon") == 2 * 2
    assert 'class="camera doubtful"' in page
    for svg in page.split("<svg")[1:]:
        ElementTree.fromstring("<svg" + svg.split("</svg>")[0] + "</svg>")


def test_a_page_without_doubts_has_no_such_table():
    good = Verdict(
        0, 0, 0, 0, 0.0, 0.0, "incremental", {}, (), (), False, False, 0.0, "not checked"
    )
    assert "Not certain" not in poses_html(PhotoSet("colmap", [], []), good, b"")


def test_contact_sheet(tmp_path: Path):
    tall = tmp_path / "tall.png"
    Image.fromarray(np.full((400, 200, 3), 255, np.uint8)).save(tall)
    data = contact_sheet([tall] * (COLUMNS + 1))
    (tmp_path / "sheet.jpg").write_bytes(data)
    with Image.open(tmp_path / "sheet.jpg") as sheet:
        assert sheet.size == (COLUMNS * CELL[0], 2 * CELL[1])
        level = np.asarray(sheet.convert("L"), np.int64)
    # JPEG keeps flat areas within a few levels.
    assert abs(level[60, 80] - 255) <= 4
    assert abs(level[60, 10] - 128) <= 4
    assert abs(level[180, 400] - 128) <= 4
