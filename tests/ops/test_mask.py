"""Masks on the device against the float64 reference, on both specialisations."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.ops import loss, mask
from clgs.reference import loss as loss_reference
from clgs.reference import mask as reference
from tests.compare import assert_close, relative_l2

SIZES = [(1, 1), (1, 17), (33, 47), (64, 64), (129, 97)]


def case(rng, size):
    """An image, and a mask of 0 and 1 with a hole in it."""
    image = rng.uniform(-0.1, 1.2, (3, *size)).astype(np.float32)
    used = (rng.uniform(size=size) < 0.8).astype(np.uint8)
    used[size[0] // 3 : size[0] // 2] = 0
    return image, used


@pytest.mark.parametrize("size", SIZES)
def test_agrees_with_reference(device, rng, size):
    image, used = case(rng, size)
    uploaded, on_device = device.upload(image), device.upload(used)
    wanted = reference.forward(image.astype(np.float64), used)
    # products with 0 and 1 are exact
    assert np.array_equal(device.download(mask.forward(device, uploaded, on_device)), wanted)
    wanted = reference.backward(image.astype(np.float64), used)
    assert np.array_equal(device.download(mask.backward(device, uploaded, on_device)), wanted)


def test_a_mask_of_ones_changes_no_bit(device, rng):
    image, used = case(rng, (31, 18))
    ones = device.upload(np.ones_like(used))
    assert np.array_equal(device.download(mask.forward(device, device.upload(image), ones)), image)


def test_masked_loss_and_its_gradient_are_the_reference_s(device, rng):
    image, used = case(rng, (75, 61))
    photo = rng.integers(0, 256, image.shape).astype(np.uint8) * used
    uploaded, on_device, target = map(device.upload, (image, used, photo))
    masked = mask.forward(device, uploaded, on_device)
    compared = loss.forward(device, masked, target)
    found = mask.backward(device, loss.backward(device, masked, target, compared), on_device)
    wide = reference.forward(image.astype(np.float64), used)
    # sums of 13,725 terms by blocks: the bound of the loss without a mask
    value = loss_reference.forward(wide, photo).value
    assert_close(compared.value(device).value, value, 1e-6, "value")
    wanted = reference.backward(loss_reference.backward(wide, photo), used)
    d_image = device.download(found)
    assert relative_l2(d_image, wanted) <= 1e-5
    assert not d_image[:, used == 0].any()


def test_what_is_masked_does_not_matter(device, rng):
    image, used = case(rng, (40, 40))
    other = np.where(used, image, np.float32(7))
    target = device.upload(rng.integers(0, 256, image.shape).astype(np.uint8) * used)
    on_device, results = device.upload(used), []
    for picture in (image, other):
        masked = mask.forward(device, device.upload(picture), on_device)
        compared = loss.forward(device, masked, target)
        d_image = mask.backward(device, loss.backward(device, masked, target, compared), on_device)
        results.append((compared.value(device), device.download(d_image).tobytes()))
    assert results[0] == results[1]


def test_not_a_number_stays_one(device, rng):
    image, used = case(rng, (5, 7))
    used[2, 3], image[1, 2, 3] = 0, np.nan
    found = device.download(mask.forward(device, device.upload(image), device.upload(used)))
    assert np.isnan(found[1, 2, 3])


def test_wrong_arrays_are_refused(device, rng):
    image, used = (device.upload(array) for array in case(rng, (4, 4)))
    with pytest.raises(ValueError, match="used"):
        mask.forward(device, image, image)
    with pytest.raises((ValueError, TypeError), match="image"):
        mask.forward(device, used, used)
