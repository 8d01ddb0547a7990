"""A trained scene is drawn right at other sizes and distances than those of its photos."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.scene_decoder import decode
from clgs.render.renderer import Renderer
from clgs.scene.camera import UNKNOWN, photo_range
from clgs.train.config import preset
from clgs.train.run.session import train_scene

STEPS = 120


@pytest.fixture(scope="module")
def run(dataset, open_device, tmp_path_factory):
    config = replace(preset("default").scaled(STEPS), voxel=0.05)
    return train_scene(dataset, tmp_path_factory.mktemp("run"), config, device=open_device("cpu"))


def psnr(device, scene, view, factor):
    """PSNR of a view that is reduced this many times, by the mean over pixels of the photo."""
    found = Renderer(device, scene).render(view.camera.reduced(factor)).clip(0, 1)
    photo = np.asarray(view.photo.planes((0.0, 0.0, 0.0), factor, final=True)) / 255
    return -10 * np.log10(np.mean((found - photo) ** 2))


def without_photos(scene):
    return replace(scene, settings=replace(scene.settings, photos=UNKNOWN))


def test_the_file_knows_the_photos_that_were_trained_on(dataset, run):
    wanted = photo_range([view.camera for view in dataset.train])
    assert run.scene.settings.photos == wanted
    assert decode(run.bitstream).settings == run.scene.settings


@pytest.mark.parametrize("factor", [2, 4])
def test_reduced_pictures_are_those_of_reduced_photos(cpu, dataset, run, factor):
    scene = run.scene.dequantize()
    gains = [
        psnr(cpu, scene, view, factor) - psnr(cpu, without_photos(scene), view, factor)
        for view in dataset.train
    ]
    assert np.mean(gains) > 1


def test_pictures_of_the_photos_are_what_was_trained(cpu, dataset, run):
    scene = run.scene.dequantize()
    with_them, without = Renderer(cpu, scene), Renderer(cpu, without_photos(scene))
    for view in dataset.train:
        np.testing.assert_array_equal(with_them.render(view.camera), without.render(view.camera))


def test_an_enlarged_picture_is_that_of_training_enlarged(cpu, dataset, run):
    """The mean over 4 x 4 pixels of it is nearer to the picture of training than without."""
    scene, camera = run.scene.dequantize(), dataset.train[0].camera
    large = camera.resized(4 * camera.width, 4 * camera.height)
    wanted, errors = Renderer(cpu, scene).render(camera), []
    for one in (scene, without_photos(scene)):
        found = Renderer(cpu, one).render(large)
        mean = found.reshape(3, camera.height, 4, camera.width, 4).mean(axis=(2, 4))
        errors.append(np.mean((mean - wanted) ** 2))
    assert errors[0] < 0.5 * errors[1]
