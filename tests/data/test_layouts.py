"""Layouts of other programs, names that differ in form, masks named otherwise."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from clgs.data.dataset import load_dataset, read_photo_set
from clgs.doctor.dataset import examine
from clgs.errors import DataError
from tests.data.folders import save_json, write_blender, write_colmap, write_transforms

pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")

LAYOUTS = {
    "the dense workspace": ("dense/0/sparse", "dense/0/images"),
    "one dense workspace": ("dense/sparse", "dense/images"),
    "a second dense model": ("dense/0/sparse/1", "dense/0/images"),
    "next to the folder of photos": (".", "images"),
    "next to the photos": (".", "."),
    "inside of nerfstudio's folder": ("colmap/sparse/0", "images"),
    "next to the photos of a workspace": ("dense/0", "dense/0"),
    "photos next to sparse": ("sparse/0", "."),
    "reduced photos alone": ("sparse/0", "images_4"),
    "photos of 3DGS's script": ("sparse/0", "input"),
    "3DGS's script before it undistorts": ("distorted/sparse/0", "input"),
    "capitals": ("Sparse/0", "Images"),
    "a model with a name": ("sparse/aligned", "images"),
    "nerfstudio's text": ("colmap_text", "images"),
    "next to a folder with capitals": (".", "Images"),
}


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("text", [False, True])
def test_layouts_of_other_programs(tmp_path, name, text):
    model, images = (tmp_path / "there" / each for each in LAYOUTS[name])
    write_colmap(tmp_path / "here", text=text)
    for source, target in (("sparse/0", model), ("images", images)):
        target.mkdir(parents=True, exist_ok=True)
        for file in (tmp_path / "here" / source).iterdir():
            file.rename(target / file.name)
    photos = read_photo_set(tmp_path / "there")
    assert (len(photos.train), len(photos.test), photos.missing) == (8, 2, [])
    assert photos.models == {}


@pytest.mark.parametrize("undistorted", [False, True])
def test_each_model_of_3dgs_s_script_has_its_own_photos(tmp_path, undistorted):
    write_colmap(tmp_path)
    (tmp_path / "distorted").mkdir()
    shutil.copytree(tmp_path / "images", tmp_path / "input")
    if undistorted:
        shutil.copytree(tmp_path / "sparse", tmp_path / "distorted" / "sparse")
    else:
        (tmp_path / "sparse").rename(tmp_path / "distorted" / "sparse")
    photos = read_photo_set(tmp_path)
    wanted = tmp_path / ("images" if undistorted else "input")
    assert {photo.path.parent for photo in photos.train + photos.test} == {wanted}


@pytest.mark.parametrize("text", [False, True])
def test_the_largest_model_is_read_and_named(tmp_path, text, caplog):
    write_colmap(tmp_path, text=text)
    import pycolmap

    whole = tmp_path / "sparse" / "0"
    part = pycolmap.Reconstruction(str(whole))
    for frame in range(1, 8):
        part.deregister_frame(frame)
    whole.rename(tmp_path / "sparse" / "10")
    whole.mkdir()
    (part.write_text if text else part.write_binary)(whole)
    data = load_dataset(tmp_path, load_images=False)
    assert len(data.train) + len(data.test) == 10
    said = "there are 2 COLMAP models; sparse/10 with 10 photos is read, not sparse/0 with 3"
    assert said in caplog.text
    assert said in [one.problem for one in examine(tmp_path).findings]


NAMES = {
    "capitals": ("images/001.jpg", "images/001.JPG"),
    "the other spelling of JPEG": ("images/001.jpeg", "images/001.JPG"),
    "a colon": ("images/10:30.jpg", "images/10:30.jpg"),
    "a colon that Windows replaced": ("images/10:30.jpg", "images/10_30.jpg"),
    "a letter and a colon": ("a:1.jpg", "a:1.jpg"),
    "a path of Windows": ("C:\\data\\IMAGES\\001.jpg", "images/001.jpg"),
    "a path of another machine": ("/home/you/shots/001.jpg", "images/001.jpg"),
    "slashes of Windows": ("images\\001.jpg", "images/001.jpg"),
    "no folder but a backslash": ("images/a\\001.jpg", "images/a\\001.jpg"),
    "an escaped blank": ("images/a%20b.jpg", "images/a b.jpg"),
    "two forms of a letter": ("images/\u00fc.jpg", "images/u\u0308.jpg"),
    "no suffix": ("images/A", "images/a.Jpg"),
}


@pytest.mark.skipif(os.name == "nt", reason="has no such names")
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["colmap", "transforms"])
def test_names_that_differ_in_form_are_found(tmp_path, name, kind, caplog):
    listed, there = NAMES[name]
    if kind == "colmap":
        write_colmap(tmp_path)
        file, base = tmp_path / "sparse" / "0" / "images.bin", tmp_path / "images" / "images"
        file.write_bytes(file.read_bytes().replace(b"002.png\0", listed.encode() + b"\0"))
        missing, folder = "002.png", tmp_path / "images"
    else:
        missing, folder = "images/000.png", tmp_path
        document = write_transforms(tmp_path, 10)
        document["frames"][0]["file_path"] = listed
        save_json(tmp_path, document)
        base = tmp_path / "images"
    base.mkdir(exist_ok=True)
    (folder / missing).rename(folder / there)
    photos = read_photo_set(tmp_path)
    assert there in [photo.name for photo in photos.train + photos.test]
    assert photos.missing == []


def test_a_name_that_two_files_fit_is_missing(tmp_path, caplog):
    write_colmap(tmp_path)
    images = tmp_path / "images"
    (images / "002.png").rename(images / "002.PNG")
    (images / "002.pNg").touch()
    if len(list(images.iterdir())) < 11:
        pytest.skip("the file system does not tell capitals apart")
    assert read_photo_set(tmp_path).missing == ["002.png"]
    assert "2 files fit" in caplog.text


def test_names_of_files_that_are_there_are_told(tmp_path):
    write_colmap(tmp_path)
    for path in list((tmp_path / "images").iterdir()):
        path.rename(path.with_name(f"new_{path.name}"))
    with pytest.raises(DataError, match=r"'new_001\.png' is one of 10 that are there; put them"):
        read_photo_set(tmp_path)


def test_files_in_folders_are_told_as_well(tmp_path):
    document = write_transforms(tmp_path, 4)
    for frame in document["frames"]:
        frame["file_path"] = Path(frame["file_path"]).name
    save_json(tmp_path, document)
    with pytest.raises(DataError, match=r"'images/000\.png' is one of 4 that are there; put them"):
        read_photo_set(tmp_path)


def test_spaces_of_other_widths_are_spaces(tmp_path):
    document = write_transforms(tmp_path, 4)
    for frame in document["frames"]:
        path = tmp_path / frame["file_path"]
        path.rename(path.with_name(f"shot 9.41\u202f{path.name}"))
        frame["file_path"] = f"images/shot 9.41 {path.name}"
    save_json(tmp_path, document)
    assert read_photo_set(tmp_path).missing == []


MASKS = [
    *("masks/002.png", "masks/002.png.png", "masks/002.jpg", "mask/002.png.jpg"),
    *("masks/002_mask.png", "masks/002.png_mask.jpg", "images/masks/002.png"),
    *("images/002_mask.png", "images/002.mask.jpg", "masks/002.mask.webp"),
    *("Masks/002.png", "MASKS/002.PNG", "images/002_mask.JPG"),
]


@pytest.mark.parametrize("name", MASKS)
@pytest.mark.parametrize("kind", ["colmap", "transforms"])
def test_masks_are_found_by_plain_names(tmp_path, name, kind):
    (write_colmap if kind == "colmap" else write_transforms)(tmp_path)
    for path in (tmp_path / name, tmp_path / name.replace("002", "stray")):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes((tmp_path / "images" / "002.png").read_bytes())
    photos = read_photo_set(tmp_path)
    masked = [photo for photo in photos.train + photos.test if photo.mask]
    assert [(photo.path.name, photo.mask) for photo in masked] == [("002.png", tmp_path / name)]
    assert photos.stray_masks == [name.replace("002", "stray")]


@pytest.mark.parametrize(
    "name", ["masks/{}/r_1.png", "masks/{}/r_1_mask.png", "{}/masks/r_1.png", "{}/r_1_mask.png"]
)
def test_masks_of_blender_captures_are_found(tmp_path, name):
    """Both splits have a photo r_1: each has its own mask."""
    write_blender(tmp_path)
    for split in ("train", "test"):
        for number in ("r_1", "stray"):
            path = tmp_path / name.format(split).replace("r_1", number)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes((tmp_path / split / "r_1.png").read_bytes())
    photos = read_photo_set(tmp_path)
    masks = {photo.name: photo.mask for photo in photos.train + photos.test if photo.mask}
    assert masks == {f"{s}/r_1.png": tmp_path / name.format(s) for s in ("train", "test")}
    stray = name.replace("r_1", "stray")
    assert photos.stray_masks == sorted(stray.format(split) for split in ("train", "test"))


def test_a_mask_without_a_name_is_that_of_no_photo(tmp_path):
    write_blender(tmp_path)
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks" / "_mask.png").write_bytes((tmp_path / "train" / "r_1.png").read_bytes())
    photos = read_photo_set(tmp_path)
    assert not any(photo.mask for photo in photos.train + photos.test)
    assert photos.stray_masks == ["masks/_mask.png"]


@pytest.mark.parametrize("kind", ["binary", "text", "transforms", "blender"])
def test_files_in_capitals_are_found(tmp_path, kind):
    """Some disks and programs write all names so."""
    if kind in ("binary", "text"):
        write_colmap(tmp_path, text=kind == "text")
        folder = tmp_path / "sparse" / "0"
    else:
        (write_blender if kind == "blender" else write_transforms)(tmp_path)
        folder = tmp_path
    before = read_photo_set(tmp_path)
    for path in filter(Path.is_file, [*folder.iterdir()]):
        path.rename(path.with_name(path.name.upper()))
    photos = read_photo_set(tmp_path)
    for name in ("train", "test"):
        found, wanted = getattr(photos, name), getattr(before, name)
        assert [photo.name for photo in found] == [photo.name for photo in wanted]
    assert np.array_equal(photos.points, before.points)
    assert examine(tmp_path).summary.startswith(f"{tmp_path}: {before.kind}")


def test_two_files_that_differ_in_capitals_are_not_guessed(tmp_path):
    write_transforms(tmp_path)
    text = (tmp_path / "transforms.json").read_text()
    (tmp_path / "transforms.json").rename(tmp_path / "Transforms.json")
    (tmp_path / "TRANSFORMS.json").write_text(text)
    with pytest.raises(DataError, match="photos without poses"):
        read_photo_set(tmp_path)
