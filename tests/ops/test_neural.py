"""The kernels of the neural Gaussians against the float64 reference, on both specialisations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.lab.kernels import drawn_rows
from clgs.ops import neural
from clgs.ops.mlp import Activations, padded_size
from clgs.options import DEFAULT
from clgs.reference import neural as reference
from tests.compare import assert_close, relative_l2
from tests.ops.cases.anchors import on_device
from tests.ops.cases.neural import case, gradients, widen

EPSILON = 2.0**-24
FIELDS = ("mean", "scale", "rotation", "color", "opacity", "slot")
COUNTS = [(0, 5), (1, 1), (33, 100), (700, 900)]


def upload(device, values):
    """Activations and anchors; the output is padded with positive numbers, which must not count."""
    visible = values["output"].shape[1]
    padded = np.full((110, padded_size(visible)), 0.5, np.float32)
    padded[:, :visible] = values["output"]
    activations = Activations(
        output=device.upload(padded),
        visible=device.upload(values["visible"]),
        active=device.zeros((1,), np.int32),
        options=DEFAULT,
    )
    return activations, on_device(device, values)


def run_forward(device, values):
    result = neural.forward(device, *upload(device, values))
    return result, {name: device.download(getattr(result, name)) for name in FIELDS}


def counted(values):
    """Where d_output counts: drawn slots of anchors; padded like the outputs on the device."""
    drawn = np.zeros((110, padded_size(len(values["visible"]))), bool)
    drawn[:, : len(values["visible"])] = drawn_rows(values["output"]) & (values["visible"] >= 0)
    drawn[:10, : len(values["visible"])] &= values["output"][:10] > 0
    return drawn


def run_backward(device, values, d_gaussians):
    inputs = upload(device, values)
    gaussians = neural.forward(device, *inputs)
    given = neural.GaussianGradients(**{n: device.upload(v) for n, v in d_gaussians.items()})
    result = neural.backward(device, gaussians, *inputs, given)
    return downloaded(device, values, result)


def downloaded(device, values, gradients):
    """Host copies, with zeros where d_output does not count."""
    found = {name: device.download(array) for name, array in vars(gradients).items()}
    found["d_output"] = np.where(counted(values), found["d_output"], np.float32(0))
    return found


def expected_backward(values, d_gaussians):
    wide = widen(values)
    gaussians = reference.forward(**wide)
    del wide["position"]
    given = reference.GaussianGradients(**widen(d_gaussians))
    result = reference.backward(gaussians, **wide, d_gaussians=given)
    return dict(zip(("d_output", "d_offset", "d_scaling"), result, strict=True))


def output_terms(values, d_gaussians):
    """Sums of absolute terms of d_output: 1 - sigmoid and d - n (n . d) cancel."""
    wide = widen(values)
    gaussians = reference.forward(**wide)
    slots = wide["output"].shape[1] * 10
    opacity, color, covariance = np.zeros(slots), np.zeros((slots, 3)), np.zeros((slots, 7))
    unit = np.abs(gaussians.rotation)
    along = np.sum(d_gaussians["d_rotation"] * unit, axis=1, keepdims=True)
    length = reference.unit_quaternion(reference.split(wide["output"])[3][gaussians.slot])[1]
    covariance[gaussians.slot, :3] = d_gaussians["d_scale"] * gaussians.scale
    covariance[gaussians.slot, 3:] = (d_gaussians["d_rotation"] + along * unit) / length
    return reference.join(opacity, color, covariance)


@pytest.mark.parametrize("counts", COUNTS)
def test_forward_agrees_with_reference(device, rng, counts):
    values = case(rng, *counts)
    result, actual = run_forward(device, values)
    expected = reference.forward(**widen(values))
    assert len(result) == np.sum(values["output"][:10] > 0)
    assert np.array_equal(actual["slot"], expected.slot)
    assert np.array_equal(actual["color"], expected.color.astype(np.float32))
    assert np.array_equal(actual["opacity"], expected.opacity.astype(np.float32))
    # one fused product and sum; the exponential is good to 1e-7 = 1.7 epsilon
    anchor = values["visible"][expected.slot // 10]
    terms = np.abs(expected.mean) + 2 * np.abs(expected.mean - values["position"][anchor])
    assert_close(actual["mean"], expected.mean, 2 * EPSILON * terms, "mean")
    # two exponentials, a sum, a division, a product: 2 x 2 + 3
    assert_close(actual["scale"], expected.scale, 7 * EPSILON * expected.scale, "scale")
    # two divisions, a root, a sum of four squares
    assert_close(actual["rotation"], expected.rotation, 5 * EPSILON, "rotation")


@pytest.mark.parametrize("counts", COUNTS)
def test_backward_agrees_with_reference(device, rng, counts):
    values = case(rng, *counts)
    visible = counts[0]
    d_gaussians = gradients(rng, int(np.sum(values["output"][:10] > 0)))
    actual = run_backward(device, values, d_gaussians)
    expected = expected_backward(values, d_gaussians)
    actual["d_output"] = actual["d_output"][:, :visible]
    for name, array in actual.items():
        assert relative_l2(array, expected[name]) <= 1e-6, name
        assert np.array_equal(array == 0, expected[name] == 0), name
    # sums of absolute terms: the same gradients of absolute values
    plain = {name: np.abs(value) for name, value in d_gaussians.items()}
    terms = expected_backward({**values, "offset": np.abs(values["offset"])}, plain)
    # products of four rounded factors, 1.7 epsilon of an exponential, up to ten terms in a row
    for name in ("d_offset", "d_scaling"):
        assert_close(actual[name], expected[name], 6 * EPSILON * terms[name], name)
    limit = 12 * EPSILON * output_terms(values, plain)
    assert_close(actual["d_output"], expected["d_output"], limit, "d_output")


@pytest.mark.parametrize("opacity", [-1.0, -0.0, np.nan])
def test_nothing_is_drawn(device, rng, opacity):
    values = case(rng, 65, 80)
    values["output"][:10] = opacity
    result, actual = run_forward(device, values)
    assert len(result) == 0
    assert [array.shape[0] for array in actual.values()] == [0] * 6
    for array in run_backward(device, values, gradients(rng, 0)).values():
        assert not array.any()


def test_infinite_opacity_is_passed_on_for_projection_to_cull(device, rng):
    values = case(rng, 4, 4)
    values["output"][:10] = -1
    values["output"][3, 2] = np.inf
    _, actual = run_forward(device, values)
    assert actual["slot"].tolist() == [23]
    assert actual["opacity"].tolist() == [np.inf]


@pytest.mark.parametrize("factor", [0.0, 1e-37, 1e-30, 1e30, np.inf, np.nan])
def test_quaternions_of_any_length(device, factor):
    """N03: the direction does not depend on the length; without one the rotation is 0."""
    rng = np.random.default_rng(3)
    values = case(rng, 6, 6)
    d_gaussians = gradients(rng, int(np.sum(values["output"][:10] > 0)))
    plain = run_forward(device, values)[1]["rotation"]
    rows = [40 + 7 * j + i for j in range(10) for i in range(3, 7)]
    with np.errstate(invalid="ignore"):
        values["output"][rows] *= np.float32(factor)
    rotation = run_forward(device, values)[1]["rotation"]
    if 1e-34 < factor < 1e36:
        assert_close(rotation, plain, 1e-6, "rotation")
    else:
        assert not rotation.any()
    assert all(
        np.isfinite(array).all() for array in run_backward(device, values, d_gaussians).values()
    )


@pytest.mark.parametrize("log_scale", [-1e4, -20, 20, 88, np.inf])
def test_log_scales_are_clamped(device, rng, log_scale):
    """N04: finite for any log scale, no gradient beyond the limits."""
    values = case(rng, 20, 20)
    values["scaling"][:] = log_scale
    _, actual = run_forward(device, values)
    for name, array in actual.items():
        assert np.isfinite(array).all(), name
    d_gaussians = gradients(rng, len(actual["slot"]))
    found = run_backward(device, values, d_gaussians)
    assert all(np.isfinite(array).all() for array in found.values())
    expected = expected_backward(values, d_gaussians)
    assert relative_l2(found["d_scaling"], expected["d_scaling"]) <= 1e-6
    assert found["d_scaling"].any() == (abs(log_scale) <= 20)


@pytest.mark.parametrize("slot", ["position", "offset", "scaling", "output"])
@pytest.mark.parametrize("poison", [np.nan, np.inf, 1e38])
def test_poison_stays_in_its_anchor(device, rng, slot, poison):
    values = case(rng, 65, 65)
    values["output"][:10, 30] = 0.5
    clean = run_forward(device, values)[1]
    d_gaussians = gradients(rng, len(clean["slot"]))
    clean_gradients = run_backward(device, values, d_gaussians)
    if slot == "output":
        values["output"][10:, 30] = poison
    else:
        values[slot][30] = poison
    dirty = run_forward(device, values)[1]
    others = clean["slot"] // 10 != 30
    for name, array in clean.items():
        assert np.array_equal(array[others], dirty[name][others]), name
    rest = np.arange(65) != 30
    found = run_backward(device, values, d_gaussians)
    assert np.array_equal(
        found["d_output"][:, :65][:, rest], clean_gradients["d_output"][:, :65][:, rest]
    )
    for name in ("d_offset", "d_scaling"):
        assert np.array_equal(found[name][rest], clean_gradients[name][rest]), name
    # culled by projection, its gradients are zero, and zero they stay
    for array in d_gaussians.values():
        array[~others] = 0
    for name, array in run_backward(device, values, d_gaussians).items():
        assert np.isfinite(array).all(), name


def test_any_nan_in_a_log_scale_stays_one(device, rng):
    """A NaN of any payload shows: exponentials work on the bits, which must not hide it."""
    values = case(rng, 4, 4)
    values["output"][:10] = 0.5
    payloads = np.array([0x7FC00000, 0xFFC00000, 0x7FFFFFFF, 0x7FC00001], np.uint32)
    values["scaling"][:, 4] = payloads.view(np.float32)
    scale = run_forward(device, values)[1]["scale"]
    assert np.isnan(scale[:, 1]).all()
    assert np.isfinite(scale[:, [0, 2]]).all()


def test_outputs_of_slots_that_are_not_drawn_are_never_read(device, rng):
    values = case(rng, 65, 80)
    dirty = {name: value.copy() for name, value in values.items()}
    dead = ~(values["output"][:10] > 0)
    for rows in (range(10, 40), range(40, 110)):
        each = len(rows) // 10
        dirty["output"][rows] = np.where(dead.repeat(each, 0), np.nan, dirty["output"][rows])
    assert np.isnan(dirty["output"]).sum() == 10 * dead.sum() > 1000
    d_gaussians = gradients(rng, int((~dead).sum()))
    for run in (
        lambda given: run_forward(device, given)[1],
        lambda given: run_backward(device, given, d_gaussians),
    ):
        clean, found = run(values), run(dirty)
        for name, array in clean.items():
            assert np.array_equal(found[name], array), name


def with_holes(values, rng):
    """The same anchors with entries -1 between them and behind; their outputs are garbage."""
    count = len(values["visible"])
    places = np.sort(rng.choice(count + 21, count, replace=False))
    output = rng.uniform(0.1, 1, (110, count + 21)).astype(np.float32)
    visible = np.full(count + 21, -1, np.int32)
    output[:, places], visible[places] = values["output"], values["visible"]
    return {**values, "output": output, "visible": visible}, places


def test_missing_anchors_draw_nothing(device, rng):
    values = case(rng, 150, 200)
    holes, places = with_holes(values, rng)
    plain, found = run_forward(device, values)[1], run_forward(device, holes)[1]
    plain["slot"] = (places[plain["slot"] // 10] * 10 + plain["slot"] % 10).astype(np.int32)
    for name, array in plain.items():
        assert np.array_equal(found[name], array), name
    d_gaussians = gradients(rng, len(plain["slot"]))
    wanted = run_backward(device, values, d_gaussians)
    d_found = run_backward(device, holes, d_gaussians)
    d_output = d_found.pop("d_output")
    assert np.array_equal(d_output[:, places], wanted.pop("d_output")[:, :150])
    for name, array in wanted.items():
        assert np.array_equal(d_found[name], array), name


@pytest.mark.parametrize("spare", [0, 1, 1000])
def test_padding_changes_no_bit(device, rng, spare):
    values = case(rng, 150, 200)
    result, plain = run_forward(device, values)
    count = len(result)
    inputs = upload(device, values)
    padded = neural.forward(device, *inputs, count + spare)
    assert device.download(padded.total).tolist() == [count]
    for name, array in plain.items():
        found = device.download(getattr(padded, name))
        assert np.array_equal(found[:count], array), name
        assert np.all(found[count:] == (-1 if name == "slot" else 0)), name
    d_gaussians = gradients(rng, count)
    wanted = run_backward(device, values, d_gaussians)
    wide = {n: np.full((count + spare, *v.shape[1:]), 7, v.dtype) for n, v in d_gaussians.items()}
    for name, array in d_gaussians.items():
        wide[name][:count] = array
    given = neural.GaussianGradients(**{n: device.upload(v) for n, v in wide.items()})
    result = neural.backward(device, padded, *inputs, given)
    found = downloaded(device, values, result)
    for name, array in wanted.items():
        assert np.array_equal(found[name], array), name


def test_too_small_a_room_leaves_out_the_last(device, rng):
    values = case(rng, 150, 200)
    plain = run_forward(device, values)[1]
    count = len(plain["slot"])
    for room in (0, 1, count - 37):
        found = neural.forward(device, *upload(device, values), room)
        assert len(found) == room
        assert device.download(found.total).tolist() == [count]
        for name, array in plain.items():
            assert np.array_equal(device.download(getattr(found, name)), array[:room]), name


def test_wrong_shapes_are_refused(device, rng):
    values = case(rng, 33, 40)
    activations, anchors = upload(device, values)
    with pytest.raises(ValueError, match="output"):
        neural.forward(device, replace(activations, output=device.zeros((110, 32))), anchors)
    with pytest.raises(TypeError, match="position"):
        neural.forward(device, activations, anchors.map(lambda a: device.zeros(a.shape, np.int32)))
