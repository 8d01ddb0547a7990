"""Blending of any number of channels against the float64 reference."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.ops import tiles
from clgs.ops.general import channels
from clgs.ops.project import Projected
from clgs.options import DEFAULT
from clgs.reference.general import channels as reference
from clgs.reference.project import Projected as Projected64
from tests.compare import relative_l2

SIZE, COUNT = (53, 41), 160


def scene(rng, colors, count=COUNT):
    """Ellipses on the screen that overlap often, some saturated."""
    radius = rng.uniform(2, 9, count)
    stretch = rng.uniform(0.5, 2.0, count)
    values = {
        "mean2d": rng.uniform(-4, 57, (count, 2)),
        "whitening": np.stack([1 / radius, rng.normal(0, 0.4, count), stretch / radius], 1),
        "depth": rng.uniform(1, 9, count),
        "extent": np.full((count, 2), 60.0),
        "color": rng.normal(0, 1, (count, colors)),
        "opacity": np.minimum(rng.uniform(0.05, 1.2, count), 1.0),
    }
    return {name: value.astype(np.float32) for name, value in values.items()}


def draw(device, values, background, with_depth, alpha_max, groups):
    """The picture, and how to take gradients of it."""
    projected = Projected(**{name: device.upload(value) for name, value in values.items()})
    made = channels.empty_picture(
        device, SIZE, device.upload(background), with_depth, alpha_max, DEFAULT
    )
    lists = [tiles.forward(device, projected, SIZE, tile_rows=rows) for rows in groups]
    records = [channels.gather(device, projected, one, DEFAULT) for one in lists]
    parts = list(zip(lists, records, [made] * len(groups), groups, strict=True))
    for part in parts:
        channels.forward(device, projected, *part)

    def gradients(d_image, d_left, absolute):
        sums = channels.empty_sums(device, len(values["opacity"]), made)
        given = device.upload(d_image), device.upload(d_left), sums, absolute
        for part in parts:
            channels.accumulate(device, projected, *part, *given)
        return channels.finish(device, projected, made, sums, absolute)

    return made, gradients


def expected(values, background, with_depth, alpha_max):
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    projected = Projected64(*(wide[n] for n in ("mean2d", "whitening", "depth", "extent")))
    channel = np.append(wide["color"], wide["depth"][:, None], 1) if with_depth else wide["color"]
    layers = reference.layers(projected, wide["opacity"], SIZE, alpha_max)
    shared = channel, background.astype(np.float64)
    image, left = reference.forward(layers, *shared, SIZE)

    def gradients(d_image, d_left):
        given = d_image.astype(np.float64), d_left.astype(np.float64)
        return reference.backward(layers, projected, wide["opacity"], *shared, *given)

    return image, left, gradients


@pytest.mark.slow
@pytest.mark.parametrize(
    ("colors", "with_depth", "absolute", "groups"),
    [
        (3, False, True, [(0, 3)]),
        (3, True, True, [(0, 1), (1, 3)]),
        (0, True, True, [(0, 3)]),
        (35, True, False, [(0, 2), (2, 3)]),
    ],
)
def test_agrees_with_reference(device, rng, colors, with_depth, absolute, groups):
    values = scene(rng, colors)
    background = rng.normal(size=colors + with_depth).astype(np.float32)
    made, gradients = draw(device, values, background, with_depth, 0.999, groups)
    image, left, gradients64 = expected(values, background, with_depth, 0.999)
    assert (left < 2e-4).any()
    assert relative_l2(device.download(made.image), image) < 2e-6
    assert relative_l2(device.download(made.transmittance), left) < 2e-6
    d_image = rng.normal(size=image.shape).astype(np.float32)
    d_left = rng.normal(size=left.shape).astype(np.float32)
    found, wanted = gradients(d_image, d_left, absolute), gradients64(d_image, d_left)
    for name in ("d_mean2d", "d_whitening", "d_opacity"):
        assert relative_l2(device.download(getattr(found, name)), getattr(wanted, name)) < 2e-5
    if colors:
        assert relative_l2(device.download(found.d_color), wanted.d_channel[:, :colors]) < 2e-6
    if with_depth:
        assert relative_l2(device.download(found.d_depth), wanted.d_channel[:, -1]) < 2e-6
    if absolute:
        assert relative_l2(device.download(found.d_absolute), wanted.d_absolute) < 2e-5


def test_groups_of_rows_and_forms_change_no_bit(open_device, rng):
    values = scene(rng, 3)
    background = np.zeros(4, np.float32)
    d_image = rng.normal(size=(*SIZE[::-1], 4)).astype(np.float32)
    d_left = rng.normal(size=SIZE[::-1]).astype(np.float32)
    results = []
    for form, groups in (("cpu", [(0, 3)]), ("cpu", [(0, 1), (1, 2), (2, 3)]), ("gpu", [(0, 3)])):
        one = open_device(form)
        made, gradients = draw(one, values, background, True, 0.999, groups)
        found = gradients(d_image, d_left, True)
        results.append([one.download(a) for a in (made.image, *vars(found).values())])
    for other in results[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(results[0], other, strict=True))


@pytest.mark.parametrize("colors", [17, 35])
def test_smaller_launches_for_few_registers_make_the_same_bits(
    open_device, rng, monkeypatch, colors
):
    device, values = open_device("gpu"), scene(rng, colors)
    background = rng.normal(size=colors + 1).astype(np.float32)
    images = []
    for few in (False, True):
        monkeypatch.setattr(type(device), "has_few_registers", property(lambda self, f=few: f))
        launches = device.launches
        made, _ = draw(device, values, background, True, 0.999, [(0, 3)])
        images.append(
            (
                device.launches - launches,
                device.download(made.image),
                device.download(made.transmittance),
            )
        )
    assert images[1][0] > images[0][0]
    assert all(np.array_equal(a, b) for a, b in zip(images[0][1:], images[1][1:], strict=True))


def test_nothing_to_draw_shows_the_background(device, rng):
    background = np.array([0.5, -2.0, 1.0], np.float32)
    made, gradients = draw(device, scene(rng, 3, 0), background, False, 0.999, [(0, 3)])
    assert (device.download(made.image) == background).all()
    assert (device.download(made.transmittance) == 1).all()
    zero = np.zeros((*SIZE[::-1], 3), np.float32), np.zeros(SIZE[::-1], np.float32)
    assert device.download(gradients(*zero, True).d_color).shape == (0, 3)
    with pytest.raises(ValueError, match="background"):
        draw(device, scene(rng, 2), background, False, 0.999, [(0, 3)])


def test_gradients_of_what_no_pixel_shows_are_zero_without_a_sign(device, rng):
    """Compilers may choose the sign of a zero that a formula gives: Mesa's chooses another."""
    values = scene(rng, 3, 20)
    values["mean2d"][::2] = 500
    _, gradients = draw(device, values, np.zeros(3, np.float32), False, 0.999, [(0, 3)])
    d_image = rng.normal(size=(*SIZE[::-1], 3)).astype(np.float32)
    found = gradients(d_image, np.zeros(SIZE[::-1], np.float32), True)
    for name in ("d_mean2d", "d_whitening", "d_opacity"):
        gradient = device.download(getattr(found, name))
        assert not gradient[::2].view(np.uint32).any(), name
        assert gradient[1::2].any()
