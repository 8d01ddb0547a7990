"""``clgs selftest`` with several devices, one of which fails: no device hides another."""

from __future__ import annotations

import json
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from clgs.cli.main import main
from clgs.lab import figures
from clgs.lab.commands import selftest as command
from clgs.lab.selftest import render_checks, training_checks
from clgs.lab.selftest.reference_render import Check
from clgs.opencl import choose


@pytest.fixture
def devices(monkeypatch):
    """Call it with what each device's checks are (or the error that they raise)."""

    def install(**found):
        fakes = [SimpleNamespace(name=name, specialisation="cpu") for name in found]
        monkeypatch.setattr(
            command, "open_devices", lambda name: ((str(i), d) for i, d in enumerate(fakes))
        )

        def run(device):
            for one in found[device.name]:
                if isinstance(one, Exception):
                    raise one
                yield one

        monkeypatch.setattr(render_checks, "selftest", run)
        monkeypatch.setattr(figures, "machine_facts", lambda device: {"device": device.name})

    return install


def check(error, quantity="depth"):
    return Check("project", quantity, error, 1e-5, 0.5)


def test_a_line_for_each_device(devices, output_of):
    devices(a=[check(1e-6), check(5e-6, "extent")], b=[check(0.0)])
    lines = output_of("selftest").splitlines()
    assert len(lines) == 3
    assert "2 checks passed, nearest to its limit: project extent at 0.50" in lines[0]
    assert lines[2] == "all checks passed"


@pytest.mark.parametrize("bad", [check(2e-5), check(float("nan")), RuntimeError("build failed")])
def test_a_failure_is_named_and_others_go_on(devices, capsys, tmp_path, bad):
    devices(a=[check(0.0), bad], b=[check(0.0)])
    assert main(["selftest", "--json", str(tmp_path / "f.json")]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("0: a (cpu): FAIL: ")
    assert "build failed" in lines[0] or "project depth" in lines[0]
    assert "passed" in lines[1]
    assert lines[2] == "1 checks failed"
    first, second = json.loads((tmp_path / "f.json").read_text())["devices"]
    assert first["error"] or not all(one["passed"] for one in first["checks"])
    assert [one["passed"] for one in second["checks"]] == [True]


@pytest.mark.slow
def test_checks_go_on_after_one_that_raises(open_device, monkeypatch):
    def check_mask(device, rng, count):
        raise RuntimeError("CL_OUT_OF_RESOURCES:\n no more")
        yield

    monkeypatch.setattr(training_checks, "check_mask", check_mask)
    monkeypatch.setattr(render_checks, "_run", Mock(side_effect=ValueError("of no use")))
    found = list(render_checks.selftest(open_device("cpu"), render_checks.TINY))
    wrong = [(one.stage, one.quantity) for one in found if not one.passed]
    assert wrong == [
        ("render", "ValueError: of no use"),
        ("mask", "RuntimeError: CL_OUT_OF_RESOURCES: no more"),
    ]
    assert {"scan", "sort", "splats"} <= {one.stage for one in found}


def test_emulators_and_unusable_platforms_are_left_out_aloud(monkeypatch, capsys):
    from clgs.lab.commands import open_devices
    from clgs.opencl import device as device_module

    monkeypatch.delenv("PYOPENCL_CTX", raising=False)
    real = SimpleNamespace(name="cpu", platform=SimpleNamespace(name="PoCL"))
    emulator = SimpleNamespace(name="sim", platform=SimpleNamespace(name="Oclgrind"))
    monkeypatch.setattr(choose, "survey", lambda: ([emulator, real], ["platform Clover: none"]))
    monkeypatch.setattr(choose, "choose_device", lambda name: real)
    monkeypatch.setattr(device_module, "Device", lambda name: name)
    assert list(open_devices(None)) == [("1", "1")]
    assert capsys.readouterr().err.splitlines() == [
        "clgs: skipped: platform Clover: none",
        "clgs: skipped: sim: an emulator; name it with --device 0",
    ]
    assert list(open_devices("cpu")) == [("1", "cpu")]
