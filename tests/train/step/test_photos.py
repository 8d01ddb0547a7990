"""Photos and cameras as training steps see them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.data.images import Pixels
from clgs.data.view import PhotoMemory, StoredPhoto, View
from clgs.lab.scenes import camera_of
from clgs.train.config import preset
from clgs.train.step.look import TrainingPhotos
from clgs.train.step.schedule import reduction


@pytest.fixture
def view(rng):
    image = rng.integers(0, 256, (16, 16, 3)).astype(np.uint8)
    pixels = Pixels(image, rng.integers(0, 256, (16, 16)).astype(np.uint8))
    return View("photo", camera_of(16, 16), StoredPhoto.of(pixels))


def test_photos_are_composited_on_a_fixed_background(cpu, view, rng):
    photos = TrainingPhotos(cpu, [view], "white", 0.2)
    color = photos.color(rng)
    assert color == (1.0, 1.0, 1.0)
    first = photos.get(0, color)
    pixels = view.photo.pixels()
    share = pixels.alpha[..., None] / np.float32(255)
    composited = np.rint(pixels.color * share + np.float32(255) * (1 - share)).astype(np.uint8)
    assert np.array_equal(cpu.download(first.photo), composited.transpose(2, 0, 1))
    assert np.array_equal(cpu.download(first.view.background), [1, 1, 1])


def test_random_backgrounds_change_photo_and_render_alike(cpu, view, rng):
    photos = TrainingPhotos(cpu, [view], "random", 0.2)
    colors = [photos.color(rng) for _ in range(2)]
    assert colors[0] != colors[1]
    got = [photos.get(0, color) for color in colors]
    uploaded = [cpu.download(target.photo) for target in got]
    assert not np.array_equal(*uploaded)
    for target, color in zip(got, colors, strict=True):
        assert np.array_equal(cpu.download(target.view.background), np.float32(color))


@pytest.mark.parametrize("background", ["white", "random"])
@pytest.mark.parametrize("factor", [1, 2])
def test_photos_read_ahead_are_the_same(cpu, view, rng, background, factor):
    pixels, reads = view.photo.pixels(), []

    def read():
        reads.append(1)
        return pixels

    stored = StoredPhoto(read, PhotoMemory(0))
    photos = TrainingPhotos(cpu, [view, replace(view, photo=stored)], background, 0.2)
    color = photos.color(rng)
    photos.prepare([1], factor)
    photos.prepare([1], factor)
    first, second = (photos.get(index, color, factor) for index in (0, 1))
    assert np.array_equal(cpu.download(first.photo), cpu.download(second.photo))
    assert len(reads) == 1
    photos.prepare([1], factor)
    photos.prepare([0], factor)  # another view comes first: view 1 is let go
    again = photos.get(1, color, factor)
    assert np.array_equal(cpu.download(first.photo), cpu.download(again.photo))


def test_reduced_targets_are_box_means(cpu, view, rng):
    image = view.photo.pixels().color
    opaque = StoredPhoto.of(Pixels(image, None))
    photos = TrainingPhotos(cpu, [replace(view, photo=opaque)], "black", 0.2)
    whole, quarter = photos.get(0, (0, 0, 0)), photos.get(0, (0, 0, 0), 4)
    assert quarter.view.size == (4, 4)
    means = image.reshape(4, 4, 4, 4, 3).mean(axis=(1, 3)).transpose(2, 0, 1)
    assert np.abs(cpu.download(quarter.photo) - means).max() <= 0.5
    assert np.array_equal(cpu.download(quarter.view.camera), view.camera.resized(4, 4).pack(0.2))
    assert photos.get(0, (0, 0, 0)).view.size == whole.view.size == (16, 16)


def test_reduction_follows_the_schedule():
    config = preset("default").scaled(1000)
    assert {reduction(config, step) for step in range(1, 1001)} == {1}

    coarse = replace(config, coarse_to_fine=True)
    factors = [reduction(coarse, step) for step in range(1, 1001)]
    assert factors[:350] == [2] * 350
    assert factors[350:] == [1] * 650
    small = replace(coarse, accuracy="preview")
    assert [reduction(small, step) for step in (350, 351, 1000)] == [2, 2, 2]
