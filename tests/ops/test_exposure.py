"""Exposure on the device against the float64 reference, on both specialisations."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.ops import exposure
from clgs.reference import exposure as reference
from tests.compare import assert_close

EPSILON = 2.0**-24
SIZES = [(1, 1), (1, 17), (33, 47), (64, 64), (129, 97)]
PHOTOS, PHOTO, WEIGHT = 3, 1, 0.25


def case(rng, size):
    """An image, a gradient and maps, float32."""
    image = rng.uniform(0, 1.2, (3, *size)).astype(np.float32)
    d_picture = rng.normal(0, 1 / image.size, image.shape).astype(np.float32)
    maps = np.eye(3, 4) + rng.normal(0, 0.3, (PHOTOS, 3, 4))
    return image, d_picture, maps.astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_agrees_with_reference(device, rng, size):
    image, d_picture, maps = case(rng, size)
    wide = [array.astype(np.float64) for array in (image, d_picture, maps[PHOTO])]
    uploaded, d_uploaded, on_device = map(device.upload, (image, d_picture, maps))
    picture = device.download(exposure.forward(device, uploaded, on_device, PHOTO))
    # three multiplications fused with additions: three roundings of partial sums
    terms = reference.forward(np.abs(wide[0]), np.abs(wide[2])).max()
    assert_close(picture, reference.forward(wide[0], wide[2]), 3 * EPSILON * terms, "picture")

    d_maps = device.upload(np.full(maps.shape, 7, np.float32))
    d_image = exposure.backward(device, uploaded, d_uploaded, on_device, PHOTO, WEIGHT, d_maps)
    wanted, d_wanted = reference.backward(*wide, WEIGHT)
    terms = reference.backward(*map(np.abs, wide), 0.0)
    bound = 3 * EPSILON * terms[0].max()
    assert_close(device.download(d_image), wanted, bound, "d_image")
    found = device.download(d_maps)
    assert np.all(np.delete(found, PHOTO, axis=0) == 7)
    # a lane adds at most 128 pixels, a block its lanes in 8 steps, the sum at most 7 blocks; the
    # penalty is rounded twice
    bound = (128 + 8 + 7) * EPSILON * terms[1].max() + 4 * EPSILON * WEIGHT
    assert_close(found[PHOTO], d_wanted, bound, "d_maps")


def test_the_identity_changes_no_bit(device, rng):
    image, d_picture, _ = case(rng, (31, 18))
    maps = exposure.identity(device, PHOTOS)
    uploaded, d_uploaded = device.upload(image), device.upload(d_picture)
    picture = exposure.forward(device, uploaded, maps, 2)
    assert np.array_equal(device.download(picture), image)
    d_maps = device.zeros(maps.shape)
    d_image = exposure.backward(device, uploaded, d_uploaded, maps, 2, WEIGHT, d_maps)
    assert np.array_equal(device.download(d_image), d_picture)


def test_centred_maps_differ_as_before(device, rng):
    maps = case(rng, (1, 1))[2]
    on_device, stop = device.upload(maps), device.zeros((1,), np.int32)
    exposure.centre(device, on_device, stop)
    found = device.download(on_device)
    # differences from the identity below 2, added and divided, then subtracted
    wanted = reference.centre(maps.astype(np.float64))
    assert_close(found, wanted, 2 * (PHOTOS + 2) * EPSILON, "maps")
    device.write(on_device, maps)
    exposure.centre(device, on_device, device.upload(np.ones(1, np.int32)))
    assert np.array_equal(device.download(on_device), maps)


def test_not_a_number_stays_one(device, rng):
    image, d_picture, maps = case(rng, (5, 7))
    d_picture[1, 2, 3] = np.nan
    d_maps = device.zeros(maps.shape)
    arrays = [device.upload(array) for array in (image, d_picture, maps)]
    exposure.backward(device, *arrays, PHOTO, WEIGHT, d_maps)
    assert np.isnan(device.download(d_maps)[PHOTO, 1]).all()


def test_wrong_arrays_are_refused(device, rng):
    image, _, maps = (device.upload(array) for array in case(rng, (4, 4)))
    with pytest.raises(ValueError, match="photo: 3, there are 3"):
        exposure.forward(device, image, maps, 3)
    with pytest.raises(ValueError, match="maps"):
        exposure.forward(device, image, image, 0)


@pytest.mark.parametrize("size", SIZES)
def test_both_forms_make_the_same_bits(open_device, rng, size):
    image, d_picture, maps = case(rng, size)
    found = []
    for form in ("cpu", "gpu"):
        device = open_device(form)
        uploaded, d_uploaded, on_device = map(device.upload, (image, d_picture, maps))
        d_maps = device.zeros(maps.shape)
        arrays = uploaded, d_uploaded, on_device
        d_image = exposure.backward(device, *arrays, PHOTO, WEIGHT, d_maps)
        found.append((device.download(d_image), device.download(d_maps)))
    for mine, other in zip(*found, strict=True):
        assert np.array_equal(mine, other)
