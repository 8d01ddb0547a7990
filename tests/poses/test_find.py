"""Which files are photos, which are not, and how their masks are found."""

import os
from pathlib import Path

import pytest
from PIL import Image

from clgs.errors import DataError
from clgs.poses.find import find_photos, is_video
from tests.data.folders import noise_image


def write(path: Path, seed: int = 0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(noise_image(8, 6, seed)).save(path)
    return path


def test_folders_below_are_searched_and_names_made_flat(tmp_path: Path):
    for seed, name in enumerate(["b.jpg", "left/a.png", "left/deep/a.webp", "B.png"]):
        write(tmp_path / name, seed)
    found = find_photos(tmp_path)
    names = {one.path.relative_to(tmp_path).as_posix(): one.name for one in found.photos}
    assert names == {
        "B.png": "B.png",
        "b.jpg": "b-2.jpg",  # systems that fold capitals would see one file
        "left/a.png": "left_a.png",
        "left/deep/a.webp": "left_deep_a.webp",
    }
    assert not found.skipped


def test_what_clgs_made_among_the_photos_is_skipped(tmp_path: Path):
    write(tmp_path / "a.png", 1)
    for number, made in enumerate(("run/plan.json", "r/progress.csv", "d/sparse/0/cameras.bin"), 2):
        write(tmp_path / made.split("/")[0] / "images" / "b.png", number)
        (tmp_path / made).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / made).touch()
    found = find_photos(tmp_path)
    assert [one.name for one in found.photos] == ["a.png"]
    assert found.lines() == [f"{tmp_path}: skipped 3, folders that clgs made: d, r, run"]


def test_images_beside_other_sizes_is_the_only_folder(tmp_path: Path):
    for folder in ("images", "images_2", "images_4"):
        write(tmp_path / folder / "a.png", len(folder))
    assert [one.name for one in find_photos(tmp_path).photos] == ["a.png"]


def test_stray_files_are_named_by_reason(tmp_path: Path):
    photo = write(tmp_path / "a.jpg")
    (tmp_path / "copy of a.jpg").write_bytes(photo.read_bytes())
    (tmp_path / "._a.jpg").write_bytes(b"Mac")
    (tmp_path / ".DS_Store").touch()
    (tmp_path / "zero.jpg").touch()
    for name in ("notes.txt", "clip.MOV", "raw.CR2", "noname"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "folder.jpg").mkdir()
    (tmp_path / "__MACOSX").mkdir()
    write(tmp_path / "__MACOSX" / "x.jpg", 3)
    write(tmp_path / ".thumbnails" / "x.jpg", 4)
    found = find_photos(tmp_path)
    assert [one.name for one in found.photos] == ["a.jpg"]
    reasons = {name: reason for name, reason in found.skipped}
    assert set(reasons) == {
        *("copy of a.jpg", "._a.jpg", ".DS_Store", "zero.jpg"),
        *("notes.txt", "clip.MOV", "raw.CR2", "noname"),
    }
    assert "same bytes" in reasons["copy of a.jpg"]
    assert "convert" in reasons["raw.CR2"]
    assert "by itself" in reasons["clip.MOV"]
    lines = found.lines()
    assert any(line.endswith("skipped 2, hidden files: .DS_Store, ._a.jpg") for line in lines)
    assert all("\n" not in line for line in lines)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes with names")
def test_links_and_pipes(tmp_path: Path):
    photo = write(tmp_path / "elsewhere" / "a.jpg")
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "a.jpg").symlink_to(photo)
    (folder / "broken.jpg").symlink_to(tmp_path / "none")
    (folder / "around").symlink_to(folder)
    os.mkfifo(folder / "pipe.jpg")
    found = find_photos(folder)
    assert [one.name for one in found.photos] == ["a.jpg"]
    reasons = {name: reason.split(";")[0] for name, reason in found.skipped}
    assert reasons == {
        "broken.jpg": "broken links",
        "around": "links to folders",
        "pipe.jpg": "no regular files",
    }


def test_names_of_any_script_stay_and_hostile_ones_are_made_safe(tmp_path: Path):
    made, long = {"Küche 1.jpg": "Küche 1.jpg", "写真.jpg": "写真.jpg"}, f"{'x' * 200}.jpg"
    made |= {"a:b.jpg": "a_b.jpg", "c\\d.jpg": "c_d.jpg", "line\nbreak.jpg": "line_break.jpg"}
    for seed, name in enumerate([*made, long]):
        write(tmp_path / name, seed)
    found = {one.path.name: one.name for one in find_photos(tmp_path).photos}
    assert len(found.pop(long)) == 120
    assert found == made
    raw = os.fsencode(tmp_path) + b"/\xff\xfe.jpg"
    Path(os.fsdecode(raw)).write_bytes((tmp_path / "写真.jpg").read_bytes() + b"\0")
    assert all(one.name.encode() for one in find_photos(tmp_path).photos)


def test_names_that_leave_no_room_for_a_mask_or_end_as_one(tmp_path: Path):
    names = [f"{'x' * 246}.jpg", "a_mask.jpg", "b.mask.jpg"]
    for seed, name in enumerate(names):
        write(tmp_path / name, seed)
    found = find_photos(tmp_path)
    assert sorted(one.path.name for one in found.photos) == sorted(names)
    assert found.skipped == []


def test_masks_are_found_by_either_name(tmp_path: Path):
    for seed, name in enumerate(["a.jpg", "b.jpg", "left/c.jpg", "d.jpg"]):
        write(tmp_path / name, seed)
    for seed, name in enumerate(["a.png", "b.jpg.png", "left/c.png", "stray.png"], 10):
        write(tmp_path / "masks" / name, seed)
    found = find_photos(tmp_path)
    masks = {one.name: one.mask and one.mask.name for one in found.photos}
    assert masks == {"a.jpg": "a.png", "b.jpg": "b.jpg.png", "left_c.jpg": "c.png", "d.jpg": None}
    assert found.skipped == [("masks/stray.png", "masks of no photo")]
    for path in (tmp_path / "masks").rglob("*.png"):
        path.rename(
            (tmp_path / path.relative_to(tmp_path / "masks")).with_stem(f"{path.stem}_mask")
        )
    found = find_photos(tmp_path)
    masks = {one.name: one.mask and one.mask.name for one in found.photos}
    assert masks["a.jpg"] == "a_mask.png"
    assert masks["left_c.jpg"] == "c_mask.png"


def test_a_data_set_of_ours_has_its_photos_in_images(tmp_path: Path):
    write(tmp_path / "contact_sheet.jpg", 1)
    write(tmp_path / "images" / "a.jpg", 2)
    assert [one.name for one in find_photos(tmp_path).photos] == [
        "contact_sheet.jpg",
        "images_a.jpg",
    ]
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    (tmp_path / "sparse" / "0" / "cameras.bin").touch()
    assert [one.name for one in find_photos(tmp_path).photos] == ["a.jpg"]


@pytest.mark.parametrize("name", ["plan.json", "progress.csv"])
def test_the_folder_of_a_run_has_no_photos(tmp_path: Path, name: str):
    write(tmp_path / "preview.png", 1)
    (tmp_path / name).touch()
    with pytest.raises(DataError, match="was made by clgs; name the folder of your own photos"):
        find_photos(tmp_path)


def test_no_folder(tmp_path: Path):
    with pytest.raises(DataError, match="no such file or folder; name photos or a video"):
        find_photos(tmp_path / "none")
    (tmp_path / "sound.wav").touch()
    with pytest.raises(DataError, match=r"sound.wav: is a file; .* or a video \(.mp4"):
        find_photos(tmp_path / "sound.wav")
    with pytest.raises(DataError, match="name the folder of the photos"):
        find_photos(write(tmp_path / "a.jpg"))
    assert not is_video(tmp_path / "none.mp4")
