"""Large photos that are reduced are decoded once, and come back with the same bits."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clgs.data import dataset, view
from clgs.data.dataset import load_dataset
from clgs.data.images import Pixels
from clgs.errors import DataError
from tests.data.folders import noise_image, write_transforms


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache of its own, for photos of any size."""
    monkeypatch.setenv("CLGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(view, "LEAST_PIXELS", 0)
    return tmp_path / "cache" / "photos"


@pytest.fixture
def decoded(monkeypatch):
    """The files of the photos that were decoded."""
    found: list[Path] = []
    read = dataset.read_image

    def note(path: Path, size: tuple[int, int]) -> Pixels:
        found.append(path)
        return read(path, size)

    monkeypatch.setattr(dataset, "read_image", note)
    return found


def pixels(root: Path, **options: object) -> list[Pixels]:
    some = load_dataset(root, load_images=False, **options)
    return [view.photo.pixels() for view in some.train + some.test]


def same(one: list[Pixels], other: list[Pixels]) -> bool:
    return all(
        np.array_equal(a.color, b.color) and np.array_equal(a.alpha, b.alpha)
        for a, b in zip(one, other, strict=True)
    )


def test_photos_are_decoded_once_per_size_contents_lens_and_meaning(
    tmp_path, cache, decoded, monkeypatch
):
    root = tmp_path / "data"
    write_transforms(root, 3, k1=0.1)
    (root / "masks").mkdir()
    for number in range(3):
        mask = np.zeros((30, 40), np.uint8)
        mask[:, 9 + number :] = 255
        Image.fromarray(mask).save(root / "masks" / f"{number:03d}.png")
    for options in ({"max_size": 16}, {"downscale": 4}, {"max_size": 16, "masks": "object"}):
        monkeypatch.setattr(view, "LEAST_REDUCTION", 1e9)
        wanted = pixels(root, **options)
        monkeypatch.setattr(view, "LEAST_REDUCTION", 4)
        decoded.clear()
        assert same(pixels(root, **options), wanted)
        assert len(decoded) == 3
        assert same(pixels(root, **options), wanted)
        assert len(decoded) == 3
    assert len(list(cache.iterdir())) == 9
    pixels(root, max_size=30)  # hardly smaller: decoded each time
    assert len(list(cache.iterdir())) == 9
    Image.fromarray(noise_image(40, 30, 9)).save(root / "images" / "001.png")
    decoded.clear()
    pixels(root, max_size=16)
    assert [path.name for path in decoded] == ["001.png"]
    write_transforms(root, 3, k1=0.2)
    decoded.clear()
    pixels(root, max_size=16)
    assert len(decoded) == 3


def test_damaged_files_of_the_cache_are_made_again(tmp_path, cache, decoded):
    write_transforms(tmp_path / "data", 2)
    wanted = pixels(tmp_path / "data", max_size=16)
    for file in cache.iterdir():
        whole = file.read_bytes()
        flipped = bytearray(whole)
        flipped[len(whole) // 2] ^= 1
        for bad in (b"", whole[: len(whole) // 2], bytes(flipped), b"no picture"):
            file.write_bytes(bad)
            assert same(pixels(tmp_path / "data", max_size=16), wanted)
            assert file.read_bytes() == whole
    assert len(decoded) == 2 + 2 * 4


def test_a_cache_that_cannot_be_used_is_no_error(tmp_path, cache):
    write_transforms(tmp_path / "data", 2)
    cache.parent.write_text("a file where the folder should be")
    assert len(pixels(tmp_path / "data", max_size=16)) == 2


def test_faults_of_photos_stay_what_they_are(tmp_path, cache):
    write_transforms(tmp_path / "data", 2)
    view = load_dataset(tmp_path / "data", max_size=16, photo_memory=0).train[0]
    path = tmp_path / "data" / view.name
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(DataError, match="damaged image"):
        view.photo.pixels()
    Image.fromarray(noise_image(40, 30, 5)).save(path)
    with pytest.raises(DataError, match="changed while it was in use"):
        view.photo.pixels()
    path.unlink()
    with pytest.raises(DataError, match="no such file"):
        view.photo.pixels()


def test_what_was_not_used_for_longest_goes(tmp_path, cache, monkeypatch):
    root = tmp_path / "data"
    write_transforms(root, 4)
    pixels(root, max_size=16)
    sizes = [file.stat().st_size for file in cache.iterdir()]
    monkeypatch.setattr(view, "LIMIT", 3 * max(sizes))
    pixels(root, max_size=17)
    assert len(list(cache.iterdir())) <= 3
