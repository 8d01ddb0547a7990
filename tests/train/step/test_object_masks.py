"""Masks that cut out an object: what is masked is transparent, and renders must show it so."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from clgs.cli.main import main
from clgs.data.dataset import load_dataset
from clgs.data.images import Pixels
from clgs.data.masks import StoredMask, meaning_of
from clgs.data.reduction import IGNORE, MEANINGS, OBJECT
from clgs.data.view import StoredPhoto, View
from clgs.errors import DataError
from clgs.lab.scenes import anchor_scene
from clgs.lab.selftest.reference_render import backward_reference, render_reference
from clgs.ops import loss
from clgs.reference import loss as loss_reference
from clgs.render.frame import upload_scene
from clgs.render.rasterise import rasterise, rasterise_backward
from clgs.render.renderer import Renderer
from clgs.train.config import preset
from clgs.train.run.trainer import Trainer
from clgs.train.state.hashes import run_digest
from clgs.train.step.look import TrainingPhotos
from tests.compare import relative_l2
from tests.data.folders import noise_image
from tests.small_scene import write_scene

SIZE = 48


@pytest.fixture(scope="module")
def masked(tmp_path_factory):
    """A transforms.json whose opaque photos have masks of the balls."""
    folder = write_scene(tmp_path_factory.mktemp("cut") / "data", train=6, test=1)
    document = json.loads((folder / "transforms_train.json").read_text())
    (folder / "masks" / "train").mkdir(parents=True)
    for frame in document["frames"]:
        frame["file_path"] += ".png"
        path = folder / frame["file_path"]
        pixels = np.asarray(Image.open(path))
        seen = pixels[..., 3:] >= 128
        Image.fromarray(np.where(seen, pixels[..., :3], noise_image(40, 40))).save(path)
        Image.fromarray(seen[..., 0]).save(folder / "masks" / frame["file_path"])
    for file in folder.glob("transforms_*"):
        file.unlink()
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


def test_pixels_outside_show_the_background_and_all_are_compared(masked, cpu):
    ignored, cut = (load_dataset(masked, masks=meaning).train[1] for meaning in MEANINGS)
    used, color = ignored.used(), (0.2, 1.0, 0.6)
    assert cut.used() is None
    found = TrainingPhotos(cpu, [cut], "random", 0.2).get(0, color)
    assert found.used is None
    planes = cpu.download(found.photo)
    assert np.array_equal(planes[:, used == 1], ignored.photo.planes(color)[:, used == 1])
    assert (planes[:, used == 0] == np.array([[51], [255], [153]])).all()
    half = cut.photo.reduced(2)
    assert np.array_equal(half.alpha, np.rint(used.reshape(20, 2, 20, 2).mean((1, 3)) * 255))


def test_what_masks_mean_is_told_by_what_they_leave(masked, tmp_path):
    masks = [photo.mask for photo in load_dataset(masked, load_images=False).photos]
    assert meaning_of(masks) == OBJECT
    opaque = [tmp_path / f"opaque_{mask.name}" for mask in masks]
    for mask, path in zip(masks, opaque, strict=True):
        Image.open(mask).convert("RGBA").save(path)
    assert meaning_of(opaque) == OBJECT
    assert meaning_of([*masks, None]) == meaning_of([]) == meaning_of(masks[:1] * 3) == IGNORE
    for number in range(3):  # the sky: most of the border is used
        used = np.zeros((40, 60), np.uint8)
        used[12 + number :] = 255
        Image.fromarray(used).save(tmp_path / f"{number}.png")
    assert meaning_of(sorted(tmp_path.glob("?.png"))) == IGNORE


@pytest.mark.slow
def test_the_plan_of_a_run_tells_what_masks_mean(masked, tmp_path, capsys):
    words = ["run", str(masked), "-o", str(tmp_path / "out"), "--plan", "--steps", "30"]
    for more, said in ([], "they cut out the object"), (["--masks", "ignore"], "not compared"):
        assert main([*words, *more]) == 0
        printed = capsys.readouterr().out
        assert "6 masks: " in printed
        assert said in printed


def test_unknown_meanings_and_photos_without_masks_are_named(masked, tmp_path, caplog):
    with pytest.raises(DataError, match="masks is 'all'; give ignore or object"):
        load_dataset(masked, masks="all")
    load_dataset(write_scene(tmp_path / "plain", 3, 1), masks=OBJECT)
    assert "4 photos have no mask, so that all that they show is the object" in caplog.text


def test_gradients_match_float64(cpu):
    """Loss and gradients of a cut-out photo over a random background, by parameters and pixels."""
    scene, camera = anchor_scene(1500, SIZE, 7)
    camera = replace(camera, translation=camera.translation + np.array([0, 0, 1.0]))
    pixels = Pixels(noise_image(SIZE, SIZE), np.zeros((SIZE, SIZE), np.uint8))
    pixels.alpha[12:36, 12:36] = 255
    color = 0.7, 0.1, 0.4
    view = View("a", camera, StoredPhoto.of(pixels), masks=OBJECT)
    target = TrainingPhotos(cpu, [view], "random", scene.settings.near).get(0, color)
    uploaded = upload_scene(cpu, scene)
    frame = rasterise(cpu, uploaded, target.view)
    compared = loss.forward(cpu, frame.image, target.photo)
    d_image = loss.backward(cpu, frame.image, target.photo, compared)
    gradients = rasterise_backward(cpu, uploaded, frame, d_image, 0.0)
    reference = render_reference(cpu, scene, frame, d_image)
    photo = np.rint(255 * np.array(color))[:, None, None].repeat(SIZE, 1).repeat(SIZE, 2)
    photo[:, 12:36, 12:36] = pixels.color[12:36, 12:36].transpose(2, 0, 1)
    photo = photo.astype(np.uint8)
    value = loss_reference.forward(reference.image, photo).value
    assert compared.value(cpu).value == pytest.approx(value, rel=1e-6)
    found = cpu.download(d_image)
    assert relative_l2(found, loss_reference.backward(reference.image, photo)) <= 1e-5
    for name, wanted in backward_reference(reference, found.astype(np.float64), 0.0).items():
        assert relative_l2(cpu.download(getattr(gradients, name)), wanted) <= 1e-5, name


@pytest.mark.slow
def test_haze_around_the_object_goes(dataset, cpu):
    """Opacity where held-out photos show nothing, after the same steps with either meaning."""
    opacities = {}
    for meaning in MEANINGS:

        def change(view, meaning=meaning):
            alpha = view.photo.pixels().alpha
            level = Pixels((alpha >= 128)[..., None] * np.uint8(255), None)
            return replace(view, mask=StoredMask(lambda: level), masks=meaning)

        views = [change(view) for view in dataset.train]
        config = replace(preset("default").scaled(240), voxel=0.02, masks=meaning)
        trainer = Trainer(cpu, replace(dataset, train=views), config.for_dataset("transforms"))
        list(trainer.steps(120))
        renderer = Renderer(cpu, trainer.quantized_scene().dequantize())
        outside = [
            renderer.depth(view.camera).opacity[view.photo.pixels().alpha == 0]
            for view in dataset.test
        ]
        opacities[meaning] = float(np.concatenate(outside).mean())
    assert opacities[OBJECT] < 0.02 < 0.05 < opacities[IGNORE], opacities


def test_the_meaning_is_part_of_what_a_run_is(dataset):
    ignore, cut = (
        replace(preset("quick"), masks=meaning).for_dataset(dataset.kind) for meaning in MEANINGS
    )
    assert run_digest(dataset, ignore) != run_digest(dataset, cut)
    assert ignore.step_background == "black"
    assert cut.step_background == "random"
