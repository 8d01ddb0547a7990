"""Fingerprints of devices: repeatable, complete, and they name the first difference."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clgs.cli.main import main
from clgs.errors import DataError
from clgs.lab import kernels as limits
from clgs.lab.figures import machine_facts
from clgs.lab.scenes import ExactRandom
from clgs.lab.selftest import SHIPPED
from clgs.lab.selftest.conformance import differences, fingerprints, from_record, to_record
from clgs.opencl.device import Device
from clgs.opencl.programs import programs_of_form, read_program
from tests.house.rules import kernels_in


@pytest.fixture(scope="module")
def run_kernels():
    """Names of the kernels that the fixture ``found`` ran."""
    return set()


@pytest.fixture(scope="module")
def found(open_device, run_kernels):
    device = open_device("cpu")
    with pytest.MonkeyPatch.context() as patch:
        run = device.run
        patch.setattr(device, "run", lambda k, *a, **b: run_kernels.add(k.name) or run(k, *a, **b))
        return fingerprints(device)


def test_no_kernel_is_left_out(found, run_kernels):
    """But for those that measure the device's limits."""
    programs = programs_of_form("cpu").values()
    known = {kernel for name in programs for kernel in kernels_in(read_program(name))}
    assert known - run_kernels == {"limits_copy", "limits_fma", "limits_rounding"}


def test_splitmix_as_published():
    # of Vigna's reference program for the seed 1234567
    wanted = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    assert ExactRandom(1234567).integers(3).tolist() == wanted


def test_floats_are_exact_and_go_on_where_they_stopped():
    random = ExactRandom(7)
    first, second = random.floats((3,), 0.0, 1.0), random.floats((2, 2), 0.0, 1.0)
    together = ExactRandom(7).floats((7,), 0.0, 1.0)
    assert np.array_equal(np.concatenate([first, second.ravel()]), together)
    assert np.array_equal(together * 2.0**24, np.rint(together * 2.0**24))
    assert together.min() >= 0
    assert together.max() < 1


def test_two_runs_agree(open_device, found):
    assert differences(fingerprints(open_device("cpu")), found) == []


@pytest.mark.slow
def test_vectors_of_8_and_of_16_lanes_make_the_same_bits(open_device, found, monkeypatch):
    width = open_device("cpu").register_lanes
    monkeypatch.setenv("CLGS_LANES", "8" if width == 16 else "16")
    other = Device(specialisation="cpu")
    assert other.register_lanes != width
    assert differences(fingerprints(other), found) == []


def test_the_committed_hashes_are_those_of_today(open_device, found):
    """On the driver that they name: a change of any bit comes with a new file."""
    record = json.loads(SHIPPED.read_text())
    facts = machine_facts(open_device("cpu"))
    for fact in ("platform", "driver"):
        if facts["device"][fact] != record["device"][fact]:
            pytest.skip(f"another device: {fact} is {facts['device'][fact]}")
    assert differences(found, from_record(record)) == []


def test_every_tensor_is_its_own(found):
    assert len({one.place for one in found}) == len(found)
    scenes = {"small", "large", "needles", "numbers", "splats"}
    scenes |= {"training", "rooms", "files", "fisheye"}
    assert {one.scene for one in found} == scenes


def test_both_forms_of_the_kernels_make_the_same_bits(open_device, found):
    assert differences(fingerprints(open_device("gpu")), found) == []


def test_the_first_difference_is_named(found, tmp_path, capsys, output_of, monkeypatch):
    monkeypatch.setattr("clgs.lab.selftest.conformance.fingerprints", lambda device: found)
    record = to_record(found, {"device": "made up"})
    changed = [replace(one, sha256="0" * 64) if "d_" in one.tensor else one for one in found]
    assert from_record(json.loads(json.dumps(record))) == found
    made_elsewhere = {"device": {"specialisation": "gpu", "native_vector_width": 3}}
    (tmp_path / "other.json").write_text(json.dumps(to_record(changed, made_elsewhere)))
    assert main(["conformance", "--check", str(tmp_path / "other.json")]) == 1
    out = capsys.readouterr().out
    assert "DIFFERENT, first in scene small, loss backward, d_image" in out
    # sums depend on neither
    assert "specialisation" not in out
    assert "native_vector_width" not in out
    assert "IEEE" not in out  # this device rounds well
    assert main(["conformance", "-o", str(tmp_path / "mine.json")]) == 0
    assert json.loads((tmp_path / "mine.json").read_text())["wrongly_rounded"]["division"] == 0
    assert "bit-identical" in output_of("conformance", "--check", tmp_path / "mine.json")


def test_wrong_roundings_are_told_beside_differences(found, tmp_path, capsys, monkeypatch):
    changed = [replace(found[0], sha256="0" * 64), *found[1:]]
    (tmp_path / "other.json").write_text(json.dumps(to_record(changed, {})))
    monkeypatch.setattr("clgs.lab.selftest.conformance.fingerprints", lambda device: found)
    exact = limits.rounding

    def careless(device, x, y, z):
        values = device.download(exact(device, x, y, z))
        values[0, :7] = np.nextafter(values[0, :7], np.float32(9))
        return device.upload(values)

    monkeypatch.setattr("clgs.lab.kernels.rounding", careless)
    assert main(["conformance", "--check", str(tmp_path / "other.json")]) == 1
    out = capsys.readouterr().out
    assert "note: division: 7 of 5000 not as IEEE 754 rounds them" in out
    assert "square root" not in out


def test_without_a_file_the_shipped_hashes_are_compared(found, capsys, monkeypatch):
    monkeypatch.setattr("clgs.lab.selftest.conformance.fingerprints", lambda device: found[::-1])
    shipped = from_record(json.loads(SHIPPED.read_text()))
    assert main(["conformance", "--check"]) == int(bool(differences(found, shipped)))
    assert "check: " in capsys.readouterr().out


@pytest.mark.parametrize(
    "text",
    ["no JSON", "[]", "{}", '{"format": "x"}', '{"format": "clgs conformance 1"}', "[" * 100_000],
)
def test_a_file_of_another_kind_is_refused_before_the_work(tmp_path, refusal, monkeypatch, text):
    monkeypatch.setattr("clgs.lab.selftest.conformance.fingerprints", None)
    path = tmp_path / "bad.json"
    path.write_text(text)
    for wrong in (path, tmp_path, path / "x", tmp_path / ("x" * 300), Path("/dev/zero")):
        assert str(wrong) in refusal(3, "conformance", "--check", wrong)


def test_another_set_of_tensors_is_refused(found):
    with pytest.raises(DataError, match="another version"):
        differences(found, found[1:])


def test_tensors_that_make_no_sense_are_refused_before_the_work(
    found, tmp_path, refusal, monkeypatch
):
    monkeypatch.setattr("clgs.lab.selftest.conformance.fingerprints", None)
    path, record = tmp_path / "other.json", to_record(found, {})
    record["tensors"][0]["sha256"] = None
    path.write_text(json.dumps(record))
    assert str(path) in refusal(3, "conformance", "--check", path)
    path.write_text(json.dumps(to_record([*found, replace(found[0], sha256="0" * 64)], {})))
    said = refusal(3, "conformance", "--check", path)
    assert f"{path}: lists a tensor 2 times: {found[0].place}" in said
