"""The blend kernels against the float64 reference that takes the kernels' decisions."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from clgs.lab.kernels import count_pairs
from clgs.options import DEFAULT, PRESETS, RenderOptions, Skips
from clgs.reference import blend as reference
from clgs.reference.tiles import TileLists
from tests.compare import assert_close, relative_l2
from tests.gaussians import projected_scene
from tests.ops.cases.blend import (
    BACKGROUND,
    GRADIENTS,
    decisions,
    every_tile_lists,
    in_float64,
    regime,
    render,
    stack,
    truncation,
)

LEVEL = 1.0 / 255.0
TYPICAL = {  # count, width, height, median sigma, ratio of axes
    "small": (4000, 70, 64, 1.1, 3.0),
    "medium": (1500, 83, 70, 3.5, 3.0),
    "large": (300, 64, 50, 15.0, 3.0),
    "needles": (1500, 80, 64, 12.0, 30.0),
}


def compared(device, scene, size, rng, options=DEFAULT):
    """(kernel image, reference image, kernel gradients, reference gradients), same decisions."""
    d_image = rng.normal(size=(3, size[1], size[0])).astype(np.float32)
    rendered = render(device, scene, size, options=options)
    made, made_backward = decisions(rendered, d_image)
    assert np.array_equal(made.contributed, made_backward.contributed)
    assert np.array_equal(made.saturated, made_backward.saturated)
    arguments = in_float64(rendered, scene)
    expected = reference.forward(**arguments, size=size, decisions=made)
    assert np.all(rendered.host("last_contributor") >= expected.last_blended)
    wanted = reference.backward(**arguments, decisions=made, d_image=d_image.astype(np.float64))
    return rendered, expected, rendered.backward(d_image), wanted


@pytest.mark.parametrize("kind", TYPICAL)
def test_agrees_with_decision_matched_reference(device, rng, kind):
    count, width, height, sigma, ratio = TYPICAL[kind]
    scene = projected_scene(rng, count, width, height, sigma, ratio)
    rendered, expected, actual, wanted = compared(device, scene, (width, height), rng)
    error = np.abs(rendered.host("image") - expected.image) / LEVEL
    assert np.quantile(error, 0.999) <= 1e-3
    assert error.max() <= 5e-3
    # measured: T keeps 5e-6 relative even after 1,500 layers
    t_error = np.abs(rendered.host("transmittance") / expected.transmittance - 1)
    assert t_error.max() <= 5e-6
    for name in GRADIENTS:
        one, other = actual[name].astype(np.float64), getattr(wanted, name)
        assert relative_l2(one, other) <= 1e-5, name
        floor = np.maximum(np.abs(other), 1e-3 * np.sqrt(np.mean(other**2)))
        element = np.abs(one - other) / floor
        assert np.quantile(element, 0.99) <= 3e-4, name
        cosine = np.sum(one * other) / np.linalg.norm(one) / np.linalg.norm(other)
        assert 1 - cosine <= 1e-9, name


EXP2_ERROR = {6: 0.0, 5: 2e-7, 4: 3e-6, 3: 8e-5}
"""Relative error of alpha by the degree of the polynomial of 2^x, beyond float32's own."""


def every_degree():
    """Presets with their own degree (parity's is compared above); others for a release.

    Each pair is compiled again.
    """
    quick = {(name, preset.exp2_degree) for name, preset in PRESETS.items() if name != "parity"}
    for pair in product(PRESETS, EXP2_ERROR):
        yield pytest.param(*pair, marks=() if pair in quick else pytest.mark.release)


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "degree"), list(every_degree()))
def test_presets_agree_with_decision_matched_reference(device, rng, preset, degree):
    options = RenderOptions(accuracy=replace(PRESETS[preset], exp2_degree=degree))
    scene = projected_scene(rng, 1500, 48, 40, 3.0)
    rendered, expected, actual, wanted = compared(device, scene, (48, 40), rng, options)
    # the sum of weights is 1, and each layer's alpha dims all behind it once more
    bound = 5e-3 * LEVEL + 4 * EXP2_ERROR[degree]
    assert np.abs(rendered.host("image") - expected.image).max() <= bound
    for name in GRADIENTS:
        limit = 1e-5 + 10 * EXP2_ERROR[degree]
        assert relative_l2(actual[name], getattr(wanted, name)) <= limit, name


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_stop_where_the_reference_stops(device, rng, preset):
    """Free reference with the same truncation: decisions differ by rounding alone."""
    options = RenderOptions(accuracy=PRESETS[preset])
    scene = projected_scene(rng, 6000, 96, 80, 2.5)
    rendered = render(device, scene, (96, 80), options=options)
    expected = reference.forward(
        **in_float64(rendered, scene), size=(96, 80), truncation=truncation(options)
    )
    made = decisions(rendered, np.ones((3, 80, 96), np.float32))[0]
    unequal = made.contributed != expected.decisions.contributed
    # a decision flips where alpha or T is within its error of a bound
    error = 2e-6 + 10 * EXP2_ERROR[options.accuracy.exp2_degree]
    assert unequal.sum() <= 2 + error * 100 * made.contributed.sum()
    last = rendered.host("last_contributor")
    assert np.mean(last < expected.last_blended) <= error * 1000
    stopped = expected.transmittance < options.accuracy.transmittance_stop
    if options.accuracy.inclusive_stop:
        assert stopped.any()
    else:
        assert not stopped.any()


def test_exact_preset_is_close_to_no_truncation(device, rng):
    options = RenderOptions(accuracy=PRESETS["exact"])
    scene = projected_scene(rng, 1000, 48, 48, 3.0)
    rendered = render(device, scene, (48, 48), options=options)
    everything = in_float64(rendered, scene)
    full = every_tile_lists(device, scene, (48, 48))
    names = vars(everything["tiles"])
    everything["tiles"] = TileLists(**{n: device.download(getattr(full, n)) for n in names})
    untruncated = reference.forward(
        **everything, size=(48, 48), truncation=reference.Truncation(0.0, 0.0)
    )
    error = np.abs(rendered.host("image") - untruncated.image).max() / LEVEL
    assert error <= 0.25


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "skip", "kind"),
    [
        ("cpu", "units", "needles"),
        ("cpu", "units", "huge"),
        ("gpu", "units", "needles"),
        ("gpu", "units", "huge"),
        ("cpu", "finished", "opaque"),
        ("gpu", "finished", "opaque"),
        ("cpu", "contributors", "opaque"),
        ("gpu", "contributors", "opaque"),
        ("cpu", "empty_tiles", "few"),
    ],
)
def test_skipped_work_changes_no_bit(open_device, rng, form, skip, kind):
    """All at once, in both forms: tests/stress/test_order.py."""
    device, size = open_device(form), (75, 53)
    count, sigma, ratio = {
        "opaque": (3000, 4.0, 3.0),
        "needles": (800, 30.0, 400.0),
        "huge": (300, 2000.0, 3000.0),
        "few": (5, 1.0, 3.0),
    }[kind]
    scene = projected_scene(rng, count, *size, sigma, ratio)
    d_image = rng.normal(size=(3, size[1], size[0])).astype(np.float32)
    some, every = (
        render(device, scene, size, options=RenderOptions(skips=Skips(**{skip: on})))
        for on in (True, False)
    )
    for name in ("image", "transmittance", "last_contributor"):
        assert np.array_equal(some.host(name), every.host(name)), name
    one, other = some.backward(d_image), every.backward(d_image)
    for name in GRADIENTS:
        assert np.array_equal(one[name], other[name]), name
    works = [
        count_pairs(device, rendered.blended, device.upload(d_image)) for rendered in (some, every)
    ]
    saved = [less.visited < more.visited for less, more in zip(*works, strict=True)]
    expected = {
        "units": [True, True],
        "finished": [True, False],
        "contributors": [False, True],
        "empty_tiles": [False, False],
    }[skip]
    assert all(s or not e for s, e in zip(saved, expected, strict=True))


def test_free_reference_differs_at_few_pixels(device, rng):
    scene = projected_scene(rng, 6000, 160, 128, 1.5)
    rendered = render(device, scene, (160, 128))
    expected = reference.forward(**in_float64(rendered, scene), size=(160, 128))
    error = np.abs(rendered.host("image") - expected.image).max(axis=0) / LEVEL
    assert np.mean(error > 0.1) <= 1e-5
    assert error.max() <= 1.05


def test_both_forms_render_the_same_bits(open_device, rng):
    """Image, decisions and gradients agree: sums over a tile's pixels run in one order."""
    scene = projected_scene(rng, 4000, 120, 90, 2.5, 10.0)
    d_image = rng.normal(size=(3, 90, 120)).astype(np.float32)
    cpu, gpu = (render(open_device(name), scene, (120, 90)) for name in ("cpu", "gpu"))
    for name in ("image", "transmittance", "last_contributor"):
        assert np.array_equal(cpu.host(name), gpu.host(name)), name
    for one, other in zip(decisions(cpu, d_image), decisions(gpu, d_image), strict=True):
        assert np.array_equal(one.contributed, other.contributed)
        assert np.array_equal(one.saturated, other.saturated)
    one, other = cpu.backward(d_image), gpu.backward(d_image)
    for name in GRADIENTS:
        assert np.array_equal(one[name], other[name]), name


@pytest.mark.parametrize(("sigma", "ratio"), [(1.1, 3.0), (4.0, 40.0), (200.0, 2000.0)])
def test_tile_culling_changes_no_bit(device, rng, sigma, ratio):
    """N12: rendering with every Gaussian in every tile gives the same image and gradients."""
    scene = projected_scene(rng, 400, 75, 50, sigma, ratio)
    d_image = rng.normal(size=(3, 50, 75)).astype(np.float32)
    culled = render(device, scene, (75, 50))
    full = render(device, scene, (75, 50), every_tile_lists(device, scene, (75, 50)))
    assert len(culled.inputs["tiles"].gaussian) < len(full.inputs["tiles"].gaussian)
    for name in ("image", "transmittance"):
        assert np.array_equal(culled.host(name), full.host(name)), name
    one, other = culled.backward(d_image), full.backward(d_image)
    for name in GRADIENTS:
        assert np.array_equal(one[name], other[name]), name


@pytest.mark.family("N14")
@pytest.mark.parametrize("layers", [100, 2300])
@pytest.mark.parametrize("kind", ["thin", "mixed", "opaque last"])
def test_every_layer_of_a_deep_pixel(device, rng, layers, kind):
    """N14: the error of dL/d(alpha) relative to the largest value that it could take."""
    scene = stack(regime(kind, layers, rng), rng)
    rendered, expected, actual, wanted = compared(device, scene, (8, 1), np.random.default_rng(7))
    d_image = np.random.default_rng(7).normal(size=(3, 8))
    contributed = expected.decisions.contributed[:, :8].any(axis=1)
    assert contributed.mean() > 0.5
    assert_close(rendered.host("image"), expected.image, 2e-3 * LEVEL, "image")
    # the list's order is by layer, then pixel, as the scene's
    transmitted = np.cumprod(1 - scene.opacity.astype(np.float64).reshape(layers, 8), axis=0)
    before = np.concatenate([np.ones((1, 8)), transmitted[:-1]])
    largest = (before * np.abs(d_image).sum(axis=0)).ravel()
    error = np.abs(actual["d_opacity"] - wanted.d_opacity) / largest
    assert np.quantile(error[contributed], 0.999) <= 5e-6
    assert error[contributed].max() <= 2e-5


@pytest.mark.parametrize("count", [16, 2000])
def test_coincident_opaque_splats(device, rng, count):
    """N13: alpha saturates; the second layer already ends every pixel that it covers."""
    scene = projected_scene(rng, count, 20, 20, 5.0)
    scene = replace(
        scene,
        mean2d=np.full((count, 2), 9.7, np.float32),
        whitening=np.tile(scene.whitening[:1], (count, 1)),
        extent=np.tile(scene.extent[:1] + 20, (count, 1)),
        opacity=np.ones(count, np.float32),
    )
    rendered, expected, actual, wanted = compared(device, scene, (20, 20), rng)
    assert expected.decisions.saturated.any()
    assert_close(rendered.host("image"), expected.image, 5e-3 * LEVEL, "image")
    for name in GRADIENTS:
        assert relative_l2(actual[name], getattr(wanted, name)) <= 1e-5, name


@pytest.mark.parametrize("size", [(1, 1), (1, 17), (17, 1), (33, 47)])
def test_any_image_size(device, rng, size):
    """N26."""
    scene = projected_scene(rng, 120, *size, 3.0)
    rendered, expected, actual, wanted = compared(device, scene, size, rng)
    assert_close(rendered.host("image"), expected.image, 5e-3 * LEVEL, "image")
    for name in GRADIENTS:
        assert relative_l2(actual[name], getattr(wanted, name)) <= 1e-5, name


@pytest.mark.parametrize("count", [0, 5])
def test_nothing_drawn_leaves_the_background(device, rng, count):
    """N17: no Gaussians, or only culled ones."""
    scene = projected_scene(rng, count, 20, 30)
    scene = replace(scene, extent=np.zeros((count, 2), np.float32))
    rendered = render(device, scene, (20, 30))
    assert np.array_equal(rendered.host("image"), np.tile(BACKGROUND[:, None, None], (1, 30, 20)))
    assert np.all(rendered.host("transmittance") == 1)
    assert np.all(rendered.host("last_contributor") == 0)
    actual = rendered.backward(np.ones((3, 30, 20), np.float32))
    for name in GRADIENTS:
        assert len(actual[name]) == count
        assert np.all(actual[name] == 0), name


POISON = [np.nan, np.inf, -1e38, 1e-45]


@pytest.mark.parametrize("value", POISON)
@pytest.mark.parametrize("slot", ["mean2d", "whitening", "color", "opacity"])
def test_poison_stays_where_it_is(device, rng, slot, value):
    """One Gaussian may hold any numbers: images and gradients are finite, and NaN draws nothing."""
    scene = projected_scene(rng, 120, 40, 40, 4.0)
    array = getattr(scene, slot).copy()
    array.reshape(120, -1)[60, -1] = value
    poisoned = render(device, replace(scene, **{slot: array}), (40, 40))
    assert np.isfinite(poisoned.host("image")).all()
    d_image = rng.normal(size=(3, 40, 40)).astype(np.float32)
    gradients = poisoned.backward(d_image)
    others = np.arange(120) != 60
    for name in GRADIENTS:
        assert np.isfinite(gradients[name][others]).all(), name
    if np.isnan(value):
        keep = replace(scene, extent=np.where(others[:, None], scene.extent, 0))
        assert np.array_equal(poisoned.host("image"), render(device, keep, (40, 40)).host("image"))
        assert all(np.isfinite(gradients[name]).all() for name in GRADIENTS)


@pytest.mark.slow
def test_counted_pairs_are_those_decided(device, rng):
    scene = projected_scene(rng, 900, 70, 50, 2.0)
    rendered = render(device, scene, (70, 50))
    d_image = rng.normal(size=(3, 50, 70)).astype(np.float32)
    lists = rendered.inputs["tiles"]
    before = rendered.host("image")
    forward, backward = count_pairs(device, rendered.blended, device.upload(d_image))
    taken = int(decisions(rendered, d_image)[0].contributed.sum())
    assert forward.blended == backward.blended == taken > 0
    every = len(lists.gaussian) * 256
    # units outside of a splat are left out
    assert taken < backward.visited < every
    assert taken < forward.visited < every
    assert np.array_equal(rendered.host("image"), before)


def test_wrong_shapes_are_refused(device, rng):
    scene = projected_scene(rng, 10, 32, 32)
    rendered = render(device, scene, (32, 32))
    with pytest.raises(ValueError, match="d_image"):
        rendered.backward(np.ones((3, 31, 32), np.float32))
    with pytest.raises(ValueError, match="tile_range"):
        render(device, scene, (64, 32), replace(rendered.inputs["tiles"], size=(64, 32)))
