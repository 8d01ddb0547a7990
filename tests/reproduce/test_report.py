"""Reports of stored rows, without training; what is compared with other states."""

import json

import pytest
from reproduce.baseline import Point, read_baseline, read_published
from reproduce.report import write_report
from reproduce.results import compare, read_results
from reproduce.table import entries, read_table, run_folder
from reproduce.worker import ROW

from clgs.errors import DataError
from tests.reproduce.conftest import row

pytest.importorskip("matplotlib")


@pytest.fixture
def stored(table_file, tmp_path):
    """The table and a folder with all of its runs but the ablation's."""
    table = read_table(table_file)
    figures = {
        ("main", 0): (30.0, 1000), ("main", 1): (31.0, 2000), ("lambda", 0): (29.0, 500),
    }  # fmt: skip
    for one in entries(table):
        folder = run_folder(tmp_path / "out", one.run)
        if (one.experiment, one.seed) in figures and not folder.exists():
            psnr, size = figures[one.experiment, one.seed]
            folder.mkdir(parents=True)
            found = row(one.run, psnr, size, size // 100, settings=one.settings)
            (folder / ROW).write_text(json.dumps(found))
            (folder / "scene.clgs").write_bytes(bytes(size))
    return table


def results_of(table, tmp_path):
    return read_results(table, entries(table), tmp_path / "out")


@pytest.mark.slow
def test_a_report_has_all_that_is_stored(stored, tmp_path):
    results = results_of(stored, tmp_path)
    made = write_report(tmp_path / "docs", results, tmp_path / "out", "x --y", note="On a Sunday.")
    assert "\n\nOn a Sunday.\n\n" in (tmp_path / "docs" / "results.md").read_text()
    assert all(path.is_file() for path in made)
    text = (tmp_path / "docs" / "results.md").read_text()
    assert "Made by `x --y`" in text
    # means over seeds with their range, next to each other
    assert "| balls | main | 60 | 2 | 30.50 (30.00 to 31.00) | 30.60 (30.10 to 31.10) |" in text
    assert "1,500 (1,000 to 2,000)" in text
    assert "balls: tiny." in text
    assert "1 runs are missing: taken-away of balls." in text
    # 100 bytes of positions, 15 anchors on average, 1,500 bytes
    assert "| 53.3 (6.7 %) |" in text
    assert "](results/curve_lambda.svg)" in text
    assert (tmp_path / "docs" / "results" / "curve_lambda.svg").stat().st_size > 1000
    kept = tmp_path / "docs" / "results" / "balls_main_1.clgs"
    assert len(kept.read_bytes()) == 2000


def test_files_of_one_state_are_the_baseline_of_another(stored, tmp_path):
    results = results_of(stored, tmp_path)
    write_report(tmp_path / "docs", results, tmp_path / "out", "x")
    points = read_baseline(tmp_path / "docs" / "results.json")
    assert len(points) == len(results.cells) == 5  # of which one run is in three experiments
    assert Point("balls", "lambda", 60, 500.0, 29.0) in points
    (found,) = compare(results, points)
    assert (found.kind, found.change) == ("BD-rate", pytest.approx(0.0, abs=1e-12))


def test_a_baseline_of_twice_the_bytes_is_minus_half(stored, tmp_path):
    results = results_of(stored, tmp_path)
    theirs = [Point("balls", "", None, 1000, 29.0), Point("balls", "", 60, 2000, 30.0)]
    other = [Point("balls", "", 61, 9, 29.5), Point("balls", "main", 60, 9, 29.6)]
    (found,) = compare(results, [*theirs, *other])
    assert found.change == pytest.approx(-0.5)
    write_report(tmp_path / "docs", results, tmp_path / "out", "x", theirs)
    assert "| balls | lambda | BD-rate | -50.0 % |" in (tmp_path / "docs/results.md").read_text()


def test_one_point_is_compared_at_its_psnr(stored, tmp_path):
    (found,) = compare(results_of(stored, tmp_path), [Point("balls", "", None, 2000, 30.0)])
    assert (found.kind, found.change) == ("bytes at its PSNR", pytest.approx(-0.5))


def test_what_cannot_be_compared_says_why(stored, tmp_path):
    results = results_of(stored, tmp_path)
    (found,) = compare(results, [Point("other", "", None, 2000, 30.0)])
    assert (found.change, found.reason) == (None, "the baseline has no point of it")
    (found,) = compare(results, [Point("balls", "", None, 2000, 50.0)])
    assert (found.change, found.reason) == (None, "the curve does not reach 50.00 dB")


def test_nothing_finished_is_a_report_too(table_file, tmp_path):
    results = results_of(read_table(table_file), tmp_path)
    write_report(tmp_path, results, tmp_path / "out", "x")
    assert "Nothing is finished." in (tmp_path / "results.md").read_text()


def test_damaged_rows_are_missing(stored, tmp_path):
    before = len(results_of(stored, tmp_path).missing)
    for number, path in enumerate(sorted(tmp_path.glob("out/runs/*/row.json"))):
        path.write_text(["{", "[]", '{"run": "x"}'][number])
    found = results_of(stored, tmp_path)
    assert not found.cells
    assert len(found.missing) == before + 5


MIC = {"scene": "mic", "bytes": 1361921, "psnr": 34.3}


def rows(*found):
    return json.dumps({"rows": found})


BASELINES = [
    ("{", "is no JSON object with a field 'rows'"),
    ('{"rows": 1}', "rows: is not a list"),
    ('{"rows": [1]}', "row 1: is not an object"),
    ('{"rows": []}', "has no rows"),
    ('{"rows": [{"scene": "mic", "bytes": 1}]}', "row 1: psnr: None is no finite number"),
    (rows(MIC, {**MIC, "bytes": "x"}), "row 2: bytes: 'x' is no finite number"),
    (rows({**MIC, "bytes": 0}), "row 1: bytes: 0 is no size"),
    (rows({**MIC, "scene": ""}), "row 1: scene: is missing"),
    (rows({**MIC, "steps": "many"}), "row 1: steps: 'many' is no finite"),
]


@pytest.mark.parametrize(("text", "message"), BASELINES, ids=[x[1] for x in BASELINES])
def test_a_wrong_baseline_is_one_line(tmp_path, text, message):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(DataError) as error:
        read_baseline(path)
    line = str(error.value)
    assert line.startswith(f"{path}: {message}")
    assert "\n" not in line


def test_rows_of_others_are_a_baseline(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(rows({**MIC, "steps": 3000}, MIC))
    assert read_baseline(path) == [
        Point("mic", "", 3000, 1361921.0, 34.3),
        Point("mic", "", None, 1361921.0, 34.3),
    ]
    with pytest.raises(DataError, match=r"absent.json: No such file"):
        read_baseline(tmp_path / "absent.json")


def test_published_figures_have_what_tables_read():
    found = read_published()
    assert all(isinstance(line, str) for line in found["protocol"])
    for method in found["methods"].values():
        assert method["source"]
        for one in method["scenes"].values():
            assert one["psnr"] > 20
            assert one["megabytes"] * method["megabyte"] > 1e5
