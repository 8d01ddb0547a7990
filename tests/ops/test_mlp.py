"""The MLP kernels against the float64 reference, on both specialisations."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from clgs.ops import mlp
from clgs.reference import mlp as reference
from tests.compare import assert_close, relative_l2
from tests.ops.mlp_cases import anchors, packed_camera, some

EPSILON = 2.0**-24
COUNTS = [0, 1, 31, 33, 1025, 2500]


def upload(device, values):
    return {name: device.upload(value) for name, value in values.items()}


def run_forward(device, values, visible):
    camera = device.upload(packed_camera())
    return mlp.forward(
        device, **upload(device, values), visible=device.upload(visible), camera=camera
    )


def run_backward(device, values, visible, d_output, want_position=True):
    """Downloads of the gradients; d_output (110, V) is padded with zeros."""
    activations = run_forward(device, values, visible)
    padded = np.zeros(activations.output.shape, np.float32)
    padded[:, : len(visible)] = d_output
    result = mlp.backward(
        device,
        activations,
        device.upload(values["position"]),
        device.upload(values["weights"]),
        device.upload(packed_camera()),
        device.upload(padded),
        want_position,
    )
    names = ("d_weights", "d_feature", "d_position")
    arrays = {name: getattr(result, name) for name in names}
    return {name: device.download(array) for name, array in arrays.items() if array is not None}


def expected_activations(values, visible):
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    return reference.forward(**wide, visible=visible, camera=packed_camera())


def expected_gradients(values, visible, d_output, hidden):
    """Float64 gradients with the kernel's decisions at the kinks of the ReLU."""
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    activations = expected_activations(values, visible)
    # a unit within rounding of its kink may decide otherwise: take over sign, keep value
    activations.hidden[(hidden > 0) != (activations.hidden > 0)] *= 0
    near = (hidden > 0) & (activations.hidden == 0)
    activations.hidden[near] = hidden[near]
    arguments = (wide["position"], wide["weights"], packed_camera(), d_output.astype(np.float64))
    gradients = reference.backward(activations, *arguments)
    return dict(zip(("d_weights", "d_feature", "d_position"), gradients, strict=True))


def gradient_terms(values, visible, d_output):
    """Sums of absolute terms of every gradient: the backward pass of absolute values."""
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    forward = expected_activations(values, visible)
    # hidden values with the terms they were summed from; activations at their steepest
    hidden = np.where(forward.hidden > 0, term_sums(values, forward)[0], 0)
    steepest = np.where(np.arange(110)[:, None] < 10, 0, 0.5) + 0 * forward.output
    absolute = reference.Activations(np.abs(forward.input), hidden, steepest, visible)
    arguments = (wide["position"], np.abs(wide["weights"]), packed_camera(), np.abs(d_output))
    d_weights, d_feature, _ = reference.backward(absolute, *arguments)
    # a feature's gradient stands for those of the direction, which has the same fan-out
    step, distance = reference.view_direction(wide["position"], packed_camera()[reference.CENTRE])
    across = 4 * d_feature.max(axis=1, keepdims=True, initial=0) / distance
    return {"d_weights": d_weights, "d_feature": d_feature, "d_position": across + 0 * step}


def term_sums(values, activations):
    """Sum of absolute terms of every hidden and output sum: what the rounding scales with."""
    hidden, output = [], []
    for head in reference.heads(values["weights"].astype(np.float64)):
        terms = np.abs(head.hidden_weight) @ np.abs(activations.input[:-1])
        hidden.append(terms + np.abs(head.hidden_bias[:, None]))
        terms = np.abs(head.output_weight) @ (hidden[-1] + activations.hidden[head.units])
        output.append(terms + np.abs(head.output_bias[:, None]))
    return np.concatenate(hidden), np.concatenate(output)


@pytest.mark.parametrize("count", COUNTS)
def test_forward_agrees_with_reference(device, rng, count):
    values = anchors(rng, 3000)
    visible = some(rng, count, 3000)
    activations = run_forward(device, values, visible)
    expected = expected_activations(values, visible)
    actual = {n: device.download(getattr(activations, n)) for n in ("input", "hidden", "output")}
    for name, array in actual.items():
        assert array.shape[1] == mlp.padded_size(count)
        assert np.isfinite(array).all(), f"{name}: padding too"
    # the direction: a subtraction, three divisions and a root, all of values up to 1
    assert_close(actual["input"][:, :count], expected.input, 8 * EPSILON, "input")
    # 53 products added in order: the error of each partial sum is at most half an ulp of it, and
    # such errors average out; 8 bounds direction and sum together
    hidden_terms, output_terms = term_sums(values, expected)
    assert_close(actual["hidden"][:, :count], expected.hidden, 8 * EPSILON * hidden_terms, "hidden")
    # activations have slopes up to 1 and add two roundings of a value up to 1
    limit = 2 * EPSILON * output_terms + 4 * EPSILON
    assert_close(actual["output"][:, :count], expected.output, limit, "output")


@pytest.mark.parametrize("count", COUNTS)
def test_backward_agrees_with_reference(device, rng, count):
    values = anchors(rng, 3000)
    visible = some(rng, count, 3000)
    d_output = rng.normal(size=(110, count)).astype(np.float32)
    hidden = device.download(run_forward(device, values, visible).hidden)[:, :count]
    expected = expected_gradients(values, visible, d_output, hidden)
    terms = gradient_terms(values, visible, d_output)
    for name, array in run_backward(device, values, visible, d_output).items():
        assert relative_l2(array, expected[name]) <= 1e-6, name
        # sums of up to 110 x 50 products whose errors average out, and the rounding of activations
        assert_close(array, expected[name], 4 * EPSILON * terms[name] + 1e-30, name)


def test_slabs_do_not_change_a_bit(device, rng, monkeypatch):
    values, visible = anchors(rng, 6000), some(rng, 5000, 6000)
    d_output = rng.normal(size=(110, 5000)).astype(np.float32)
    whole = run_backward(device, values, visible, d_output)
    monkeypatch.setattr(mlp, "SLAB", dict.fromkeys(mlp.SLAB, 2 * mlp.CHUNK))
    parts = run_backward(device, values, visible, d_output)
    for name, array in whole.items():
        assert np.array_equal(array, parts[name]), name


def test_position_gradient_only_where_wanted(device, rng):
    values, visible = anchors(rng, 200), some(rng, 100, 200)
    d_output = rng.normal(size=(110, 100)).astype(np.float32)
    with_position = run_backward(device, values, visible, d_output)
    without = run_backward(device, values, visible, d_output, want_position=False)
    assert set(with_position) - set(without) == {"d_position"}
    assert np.array_equal(with_position["d_weights"], without["d_weights"])
    assert np.array_equal(with_position["d_feature"], without["d_feature"])


def test_padding_contributes_nothing(device, rng):
    values, visible = anchors(rng, 40), some(rng, 33, 40)
    activations = run_forward(device, values, visible)
    arguments = [values["position"], values["weights"], packed_camera()]
    arguments = [device.upload(value) for value in arguments]
    d_output = np.zeros(activations.output.shape, np.float32)
    d_output[:, 33:] = 1e6
    result = mlp.backward(device, activations, *arguments, device.upload(d_output), True)
    assert not device.download(result.d_weights).any()
    assert not device.download(result.d_feature).any()
    assert not device.download(result.d_position).any()


@pytest.mark.parametrize("slot", ["feature", "position"])
@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf, 1e38, 2e15])
def test_poison_stays_in_its_anchor(device, rng, slot, poison):
    values, visible = anchors(rng, 70), some(rng, 65, 70)
    d_output = rng.normal(size=(110, 65)).astype(np.float32)
    d_output[:, 30] = 0
    clean = device.download(run_forward(device, values, visible).output)
    clean_gradients = run_backward(device, values, visible, d_output)
    values[slot][visible[30]] = poison
    dirty = device.download(run_forward(device, values, visible).output)
    others = np.arange(65) != 30
    assert np.array_equal(clean[:, :65][:, others], dirty[:, :65][:, others])
    if slot == "feature" or not np.isfinite(poison):
        assert np.isnan(dirty[:, 30]).all(), "not drawn: no comparison with NaN holds"
    # whatever gradient arrives, the weights see the other anchors only
    d_output[:, 30] = 5 if np.isnan(dirty[:, 30]).all() else 0
    for name, array in run_backward(device, values, visible, d_output).items():
        assert np.array_equal(array, clean_gradients[name]), name


def test_camera_centre_has_no_direction(device, rng):
    values, visible = anchors(rng, 8), np.arange(8, dtype=np.int32)
    values["position"][3] = packed_camera()[23:26]
    values["position"][4] = packed_camera()[23:26] * np.float32(1 + 2e-7)
    d_output = rng.normal(size=(110, 8)).astype(np.float32)
    directions = device.download(run_forward(device, values, visible).input)[50:53, :8]
    assert not directions[:, 3].any()
    assert abs(np.linalg.norm(directions[:, 4]) - 1) <= 1e-6
    gradients = run_backward(device, values, visible, d_output)
    assert not gradients["d_position"][3].any()
    assert all(np.isfinite(array).all() for array in gradients.values())


def test_both_specialisations_decode_the_same(open_device, rng):
    """Rows are summed in one order everywhere; only the activations may round differently."""
    values, visible = anchors(rng, 500), some(rng, 300, 500)
    outputs = []
    for specialisation in ("cpu", "gpu"):
        device = open_device(specialisation)
        outputs.append(device.download(run_forward(device, values, visible).output)[:, :300])
    assert np.array_equal(*outputs)


HASH_SCRIPT = """
import hashlib
import numpy as np
from clgs.opencl.device import Device
from tests.ops.mlp_cases import anchors, some
from tests.ops.test_mlp import run_backward
rng = np.random.default_rng(5)
values, visible = anchors(rng, 4000), some(rng, 3333, 4000)
d_output = rng.normal(size=(110, 3333)).astype(np.float32)
for _ in range(2):
    result = run_backward(Device(specialisation="cpu"), values, visible, d_output)
    joined = b"".join(result[name].tobytes() for name in sorted(result))
    print(hashlib.sha256(joined).hexdigest())
"""


def test_threads_do_not_change_a_bit():
    hashes = set()
    for threads in ("1", "2"):
        environment = {**os.environ, "POCL_MAX_PTHREAD_COUNT": threads}
        result = subprocess.run(
            [sys.executable, "-c", HASH_SCRIPT],
            env={**environment, "PYTHONPATH": os.pathsep.join(sys.path)},
            capture_output=True,
            text=True,
            check=True,
        )
        hashes.update(result.stdout.split())
    assert len(hashes) == 1
    assert len(hashes.pop()) == 64


def test_wrong_shapes_are_refused(device, rng):
    values, visible = anchors(rng, 8), np.arange(8, dtype=np.int32)
    with pytest.raises(ValueError, match="feature"):
        run_forward(device, {**values, "feature": values["feature"][:, :49]}, visible)
    with pytest.raises(ValueError, match="weights"):
        run_forward(device, {**values, "weights": values["weights"][1:]}, visible)
    with pytest.raises(TypeError, match="visible"):
        run_forward(device, values, visible.astype(np.int64))
