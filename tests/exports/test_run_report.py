"""The page about a run, from the files of its folder."""

import json

import numpy as np
import pytest

from clgs.codec.scene_encoder import encode
from clgs.errors import DataError
from clgs.exports.pictures import save_png
from clgs.exports.report import MOST_PICTURES, REPORT, read_curve, sections, write_run_report
from tests.codec.scenes import random_scene

SUMMARY = {
    "psnr": 28.25, "train_psnr": 31.5, "ssim": 0.91, "bytes": 4096, "anchors": 50, "split": "test",
    "steps": 700, "views": 2, "device": "a device", "background": [0, 0, 0], "protocol": "clgs-1",
    "train_seconds": 12.0,
}  # fmt: skip


def make_run(folder, views=2, **changes):
    """The files of a finished run that the page is made of."""
    rng = np.random.default_rng(3)
    scores = []
    for index in range(views):
        for kind in ("gt", "renders"):
            target = folder / "test" / "ours_700" / kind
            target.mkdir(parents=True, exist_ok=True)
            save_png(target / f"v{index}.png", rng.integers(0, 256, (6, 9, 3), dtype=np.uint8))
        scores.append({"name": f"v{index}.jpg", "psnr": 20.0 + index, "ssim": 0.5})
    (folder / "per_view.json").write_text(json.dumps(scores))
    (folder / "results.json").write_text(json.dumps(SUMMARY | {"views": views} | changes))
    (folder / "scene.clgs").write_bytes(encode(random_scene(rng, 50)))
    (folder / "progress.csv").write_text(
        "step,seconds,psnr,event\n100,1.0,20.5,\n350,2.0,25.0,psnr before quantisation\n700,3,27,\n"
    )
    return folder


def test_page_tells_held_out_from_training(tmp_path):
    command, links = "clgs train data -o run", [("page", "a b.html")]
    made = write_run_report(make_run(tmp_path), command, "Trained.", {"train": 3.0}, links)
    text = made.read_text()
    for part in (
        *("28.25 dB", "31.50 dB", "PSNR, held out", "PSNR in training", "Held-out views"),
        *("clgs train data -o run", 'href="a%20b.html"', "v1.jpg: 21.00 dB", "features", "700"),
    ):
        assert part in text
    assert text.count("data:image/jpeg") == 2 * 3


def test_views_of_training_are_not_called_held_out(tmp_path):
    make_run(tmp_path, split="train")
    summary = {name: value for name, value in SUMMARY.items() if name != "train_psnr"}
    (tmp_path / "results.json").write_text(json.dumps(summary | {"split": "train"}))
    text = write_run_report(tmp_path).read_text()
    assert "Training views" in text
    assert "never saw" not in text
    assert "held out" not in text


def test_of_many_views_the_worst_and_best_are_shown(tmp_path):
    page = tmp_path / "page.html"
    write_run_report(make_run(tmp_path, MOST_PICTURES + 9), page=page)
    text = page.read_text()
    assert text.count("data:image/jpeg") == 3 * MOST_PICTURES
    assert "render of v0.jpg" in text
    assert f"render of v{MOST_PICTURES + 8}.jpg" in text
    assert not (tmp_path / REPORT).exists()


def test_curve_leaves_single_events_out(tmp_path):
    assert read_curve(make_run(tmp_path) / "progress.csv") == [(100, 20.5), (700, 27.0)]


def test_sections_add_up_to_most_of_the_file(tmp_path):
    size = (make_run(tmp_path) / "scene.clgs").stat().st_size
    assert 0.8 * size < sum(sections(tmp_path).values()) <= size


@pytest.mark.parametrize("name", ["results.json", "per_view.json", "test/ours_700/gt/v0.png"])
def test_damaged_runs_are_refused(tmp_path, name):
    path = make_run(tmp_path) / name
    path.unlink()
    with pytest.raises(DataError, match="is no whole run"):
        write_run_report(tmp_path)
