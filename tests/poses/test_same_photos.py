"""Photos of a data set are found again among files whose names it has changed."""

import json
from pathlib import Path

import numpy as np
import pytest

from clgs.data.dataset import read_photo_set
from clgs.data.lens import Lens
from clgs.data.posed_photo import Photo
from clgs.poses.find import REPORT, Found, find_photos, match_photos, read_sources
from tests.data.folders import write_room_photos
from tests.poses.test_find import write

LENS = Lens(4, 4, 4.0, 4.0, 2.0, 2.0)


def matched(files: list[str], photos: list[str], sources: dict[str, str]):
    """File by photo, and the photos that may be several files."""
    found = [Found(Path("/photos") / name, name, name) for name in files]
    posed = [
        Photo(name, Path("/data/images") / name, LENS, np.eye(3), np.zeros(3)) for name in photos
    ]
    same, unsure = match_photos(found, posed, sources)
    return {photos[n]: files[file] for n, file in same.items()}, [photos[n] for n in unsure]


@pytest.mark.parametrize(
    ("files", "photos", "sources", "same", "unsure"),
    [
        (["A.JPG", "b.png"], ["b.jpg", "a.png"], {}, {"a.png": "A.JPG", "b.jpg": "b.png"}, []),
        # names that were made safe
        (["#0.png", "_0.png"], ["_0.png", "_0-2.png"], {"_0-2": "#0.png"},
         {"_0.png": "_0.png", "_0-2.png": "#0.png"}, []),
        (["#0.png"], ["_0.png", "_0-2.png"], {"_0-2": "#0.png"}, {"_0-2.png": "#0.png"}, []),
        # folders
        (["a/1.png", "b/1.png"], ["b_1.png", "a_1.png"], {"a_1": "a/1.png", "b_1": "b/1.png"},
         {"a_1.png": "a/1.png", "b_1.png": "b/1.png"}, []),
        (["a/1.png", "b/1.png"], ["b/1.png", "a/1.png"], {},
         {"a/1.png": "a/1.png", "b/1.png": "b/1.png"}, []),
        (["x/y/1.png", "x/z/1.png"], ["z/1.jpg"], {}, {"z/1.jpg": "x/z/1.png"}, []),
        # one stem, two suffixes
        (["a.jpg", "a.png"], ["a.jpg", "a-2.png"], {"a-2": "a.png"},
         {"a.jpg": "a.jpg", "a-2.png": "a.png"}, []),
        (["a/1.png", "b/1.png"], ["1.png"], {}, {}, ["1.png"]),
        (["1.png"], ["a/1.png", "b/1.png"], {}, {}, []),
        (["1.png"], ["2.png"], {}, {}, []),
    ],
)  # fmt: skip
def test_a_photo_is_the_file_whose_name_and_folders_are_most_alike(
    files: list[str], photos: list[str], sources: dict[str, str], same: object, unsure: object
):
    assert matched(files, photos, sources) == (same, unsure)


@pytest.mark.parametrize(
    "report",
    ["", "{", "[1]", '{"photos": [1]}', '{"photos": [{"name": 1}]}', '{"photos": {"a": 1}}',
     '{"photos": [{"name": "a.png", "source": ["x"]}, {"name": "b.png", "source": ""}]}'],
)  # fmt: skip
def test_a_report_of_another_program_names_no_sources(tmp_path: Path, report: str):
    (tmp_path / REPORT).write_text(report)
    assert read_sources(tmp_path) == {}


def test_photos_that_can_keep_their_names_do(tmp_path: Path):
    for number, name in enumerate(("#0.png", "_0.png", "left/1.png", "left_1.png")):
        write(tmp_path / name, number)
    names = {one.below: one.name for one in find_photos(tmp_path).photos}
    assert names == {
        "#0.png": "_0-2.png",
        "_0.png": "_0.png",
        "left/1.png": "left_1-2.png",
        "left_1.png": "left_1.png",
    }


@pytest.mark.slow
def test_poses_of_a_data_set_whose_names_were_made_safe_go_to_the_same_photos(tmp_path: Path):
    pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    from clgs.poses.prepare import prepare

    photos, odd = tmp_path / "photos", ("#0.png", "_0.png", "a/1.png", "b/1.png", "1.png")
    write_room_photos(photos, 7)
    for number, name in enumerate(odd):
        (photos / name).parent.mkdir(exist_ok=True)
        (photos / f"{number}.png").rename(photos / f"x{number}")
    for number, name in enumerate(odd):
        (photos / f"x{number}").rename(photos / name)
    first = prepare(photos, tmp_path / "first", quick=True)
    (note,) = first.notes
    assert note == (
        "3 photos have other names in the data set: #0.png is _0-2.png, a/1.png is a_1.png, "
        "b/1.png is b_1.png"
    )
    written = json.loads((tmp_path / "first" / REPORT).read_text())["photos"]
    sources = {one["name"]: one["source"] for one in written if one["source"]}
    assert sources == {"_0-2.png": "#0.png", "a_1.png": "a/1.png", "b_1.png": "b/1.png"}
    (photos / "_0.png").unlink()  # so that #0.png is called as it was
    second = prepare(photos, tmp_path / "second", quick=True, poses=tmp_path / "first")
    assert (second.registered, second.mapper) == (6, "given poses")
    before, after = (
        {
            one.path.name: one.centre
            for one in read_photo_set(data).train + read_photo_set(data).test
        }
        for data in (tmp_path / "first", tmp_path / "second")
    )
    before["_0.png"] = before.pop("_0-2.png")
    spread = np.ptp([*before.values()], axis=0).max()
    for name, centre in after.items():
        assert np.linalg.norm(centre - before[name]) <= 0.02 * spread
