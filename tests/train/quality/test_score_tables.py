from __future__ import annotations

import csv
import json
from typing import Any

import numpy as np
import pytest

from clgs.errors import UsageError
from clgs.train.quality.scores import (
    HEADER,
    ViewScore,
    append_survey,
    check_survey,
    summarize,
    write_inria,
)
from tests.codec.scenes import random_scene


def scored(lpips: bool = True) -> tuple[dict[str, Any], list[ViewScore]]:
    """Two views with scores that are easy to average."""
    scores = [
        ViewScore("test/r_0.png", 30.0, 30.5, 0.9, 0.1, 0.25 if lpips else None),
        ViewScore("test/r_1.png", 31.0, 31.5, 0.8, 0.1, 0.75 if lpips else None),
    ]
    return summarize(random_scene(np.random.default_rng(0)), scores, 1234), scores


def test_a_summary_says_which_psnr_is_which():
    summary, scores = scored()
    assert (summary["psnr"], summary["psnr_channel_mean"], summary["lpips"]) == (30.5, 31.0, 0.5)
    for name in ("psnr:", "psnr_channel_mean:", "lpips: VGG"):
        assert name in summary["protocol"]
    assert scores[0].record()["lpips"] == 0.25
    summary, scores = scored(lpips=False)
    assert "lpips" not in summary
    assert "lpips" not in summary["protocol"]
    assert "lpips" not in scores[0].record()


def test_inria_files_hold_means_and_views(tmp_path):
    write_inria(tmp_path / "new" / "scores", "ours_30000", *scored())
    results = json.loads((tmp_path / "new/scores/results.json").read_text())
    assert list(results) == ["ours_30000"]
    assert results["ours_30000"].pop("SSIM") == pytest.approx(0.85)
    assert results == {"ours_30000": {"PSNR": 30.5, "LPIPS": 0.5, "PSNR channel mean": 31.0}}
    views = json.loads((tmp_path / "new/scores/per_view.json").read_text())["ours_30000"]
    assert views["PSNR"] == {"r_0.png": 30.0, "r_1.png": 31.0}
    assert views["LPIPS"] == {"r_0.png": 0.25, "r_1.png": 0.75}
    write_inria(tmp_path, "ours", *scored(lpips=False))
    assert set(json.loads((tmp_path / "results.json").read_text())["ours"]) == {
        "SSIM", "PSNR", "PSNR channel mean",
    }  # fmt: skip


def test_survey_rows_are_added_under_one_header(tmp_path):
    table = tmp_path / "mic.csv"
    summary = scored()[0] | {"gaussians": 77}
    append_survey(table, "Baseline", summary)
    table.write_bytes(table.read_bytes().removesuffix(b"\n"))  # as an editor may leave it
    append_survey(table, '-a, "b"', scored(lpips=False)[0] | {"gaussians": 5})
    assert table.read_text().startswith("Submethod,PSNR,SSIM,LPIPS,Size [Bytes],#Gaussians\n")
    with table.open(newline="") as file:
        header, first, second = csv.reader(file)
    assert tuple(header) == HEADER
    assert [float(cell) for cell in first[1:]] == pytest.approx([30.5, 0.85, 0.5, 1234, 77])
    assert (second[0], second[3], second[5]) == ('-a, "b"', "", "5")


@pytest.mark.parametrize("content", [b"a,b\n1,2\n", b"\xff\x00", b"Submethod,PSNR\n"])
def test_other_tables_stay_as_they_are(tmp_path, content):
    table = tmp_path / "other.csv"
    table.write_bytes(content)
    for act in (lambda: check_survey(table), lambda: append_survey(table, "", scored()[0])):
        with pytest.raises(UsageError, match="line 1 is not Submethod,PSNR"):
            act()
    assert table.read_bytes() == content
