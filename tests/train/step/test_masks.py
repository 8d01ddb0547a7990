"""Masked pixels play no part in training and scores; photos without masks train as before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.data.images import Pixels
from clgs.data.masks import StoredMask
from clgs.data.view import StoredPhoto
from clgs.train.config import preset
from clgs.train.quality.scores import evaluate_views, psnr_8bit, psnr_channel_mean, ssim
from clgs.train.run.trainer import Trainer
from clgs.train.state.hashes import run_digest
from tests.train.state.test_run_state import arrays_of

STEPS = 60


def config(dataset, **changes):
    settings = replace(preset("default").scaled(240), voxel=0.02, **changes)
    return settings.for_dataset(dataset.kind)


def masked(dataset, mask, hidden=None):
    """The data set with a mask (H, W) of 0 and 1 in all views; ``hidden``: level under it."""

    def change(view):
        color = view.photo.pixels().color
        if hidden is not None:
            color = np.where(mask[..., None], color, np.uint8(hidden))
        level = Pixels(mask[..., None] * np.uint8(255), None)
        photo = StoredPhoto.of(Pixels(color, view.photo.pixels().alpha))
        return replace(view, photo=photo, mask=StoredMask(lambda: level))

    train, test = ([change(view) for view in views] for views in (dataset.train, dataset.test))
    return replace(dataset, train=train, test=test)


@pytest.fixture
def half():
    mask = np.zeros((40, 40), np.uint8)
    mask[:, 12:] = 1
    return mask


def trained(cpu, dataset, **changes):
    trainer = Trainer(cpu, dataset, config(dataset, **changes))
    results = list(trainer.steps(STEPS))
    return results, arrays_of(cpu, trainer.state)


@pytest.mark.slow
@pytest.mark.parametrize("exposure", [False, True])
def test_what_is_hidden_changes_no_bit(dataset, cpu, half, exposure):
    first, second = (
        trained(cpu, masked(dataset, half, hidden), exposure=exposure) for hidden in (0, 255)
    )
    assert first == second


@pytest.mark.slow
def test_a_white_mask_gives_the_bits_of_none(dataset, cpu):
    ones = np.ones((40, 40), np.uint8)
    assert trained(cpu, masked(dataset, ones)) == trained(cpu, dataset)


def test_a_mask_is_part_of_what_a_run_is(dataset, half):
    digests = {
        run_digest(one, config(dataset))
        for one in (dataset, masked(dataset, half), masked(dataset, 1 - half))
    }
    assert len(digests) == 3


@pytest.mark.slow
def test_scores_do_not_see_what_is_hidden(dataset, cpu, half):
    trainer = Trainer(cpu, dataset, config(dataset))
    list(trainer.steps(20))
    scene = trainer.quantized_scene()
    shown = []
    scores = [
        [
            replace(score, seconds=0.0)
            for score in evaluate_views(
                cpu, scene, masked(dataset, half, hidden).test, lambda _, *both: shown.append(both)
            )
        ]
        for hidden in (0, 255)
    ]
    for render, photo in shown:  # reports show what was compared
        assert not render[:, :12].any()
        assert not photo[:, :12].any()
        assert render[:, 12:].any()
    assert scores[0] == scores[1]
    plain = [replace(score, seconds=0.0) for score in evaluate_views(cpu, scene, dataset.test)]
    assert plain != scores[0]


def test_measures_are_means_over_the_used_pixels(rng):
    render, photo = rng.integers(0, 256, (2, 30, 20, 3)).astype(np.uint8)
    used = np.zeros((30, 20), np.uint8)
    used[:, :13] = 1
    assert psnr_8bit(render, photo, used) == pytest.approx(psnr_8bit(render[:, :13], photo[:, :13]))
    planes = render.transpose(2, 0, 1) / 255.0
    found = psnr_channel_mean(planes, photo, used)
    assert found == pytest.approx(psnr_channel_mean(planes[:, :, :13], photo[:, :13]))
    other = np.where(used[..., None], photo, 255 - photo)
    assert ssim(render, photo, used) == ssim(render, other, used)
    # far from the border of the mask all pixels see the same
    assert ssim(photo, other, used) == pytest.approx(1.0)


def test_reduced_masks_hold_no_masked_pixel(half):
    stored = StoredMask(lambda: Pixels(half[..., None] * np.uint8(255), None))
    assert np.array_equal(stored.used(), half)
    small = stored.used(5)
    assert small.shape == (8, 8)
    assert not small[:, :3].any()  # the third column holds pixels 10 and 11
    assert small[:, 3:].all()
    assert np.array_equal(stored.used(5), small)
