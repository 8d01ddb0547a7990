"""A child process builds first, so that a driver that ends it does not end a user's process."""

from __future__ import annotations

import os
import re
import signal

import pytest

from clgs.errors import DeviceError
from clgs.opencl import choose, first_build, programs
from clgs.opencl.device import Device

CRASH = "#pragma clang __debug crash"
"""PoCL's compiler, clang, ends the process at this line."""

MASK = ("loss/mask", "mask_apply")
QUANTIZE = ("anchors/quantize", "quantize_forward")


@pytest.fixture
def device(monkeypatch, tmp_path):
    """A device that is new to this version."""
    monkeypatch.setenv("CLGS_CACHE", str(tmp_path))
    monkeypatch.setattr(first_build, "serves_cpu_form", lambda device: False)
    opened = Device()
    if opened.cl_device.platform.name != "Portable Computing Language":
        pytest.skip("PoCL's compiler ends at a pragma, others may not")
    return opened


@pytest.fixture
def broken(monkeypatch):
    """The program of the mask ends the driver's compiler."""
    read = programs.read_program

    def source(name):
        return f"{read(name)}\n{CRASH}\n" if name == "loss/mask.cl" else read(name)

    monkeypatch.setattr(programs, "read_program", source)


def notes(folder):
    return "".join(file.read_text() for file in folder.glob("drivers/*.txt")).split()


@pytest.mark.slow
@pytest.mark.usefixtures("broken")
def test_a_driver_that_crashes_ends_no_user_s_process(device, tmp_path):
    for _ in range(2):  # it is no better the next time
        with pytest.raises(DeviceError) as caught:
            device.kernel(*MASK)
        message = str(caught.value)
        assert re.search(r"kernels_cl/loss/mask\.cl \((signal|exit code) \d+.*\); ", message)
        assert device.name in message
        assert message.endswith("choose another device with --device")
        assert "\n" not in message
    assert not notes(tmp_path)
    assert device.kernel(*QUANTIZE).name == "quantize_forward"
    assert len(notes(tmp_path)) == 1


def test_drivers_that_are_known_need_no_child(monkeypatch, tmp_path):
    monkeypatch.setenv("CLGS_CACHE", str(tmp_path))
    monkeypatch.setattr(first_build, "_Child", None)
    opened = Device()
    if not choose.serves_cpu_form(opened.cl_device):
        pytest.skip("this driver is not one of the known ones")
    opened.kernel(*MASK)


def test_what_was_built_once_asks_no_child(device, monkeypatch, tmp_path):
    device.kernel(*MASK)
    assert len(notes(tmp_path)) == 1
    monkeypatch.setattr(first_build, "_Child", None)
    Device().kernel(*MASK)
    with pytest.raises(TypeError):
        Device().kernel(*MASK, UNUSED=1)  # another build


@pytest.mark.slow
def test_another_version_of_clgs_tries_again(device, monkeypatch, tmp_path):
    device.kernel(*MASK)
    monkeypatch.setattr(first_build, "__version__", "another")
    Device().kernel(*MASK)
    assert len(list(tmp_path.glob("drivers/*.txt"))) == 2


def test_a_child_that_is_killed_is_named(device):
    device.kernel(*MASK)
    os.kill(device._programs._first_builds._child._process.pid, signal.SIGKILL)
    with pytest.raises(DeviceError, match=r"quantize\.cl.*signal 9"):
        device.kernel(*QUANTIZE)


@pytest.mark.slow
def test_a_child_without_work_ends_and_another_follows(device, monkeypatch):
    monkeypatch.setattr(first_build, "IDLE_SECONDS", 0.05)
    device.kernel(*MASK)
    child = device._programs._first_builds._child
    assert child._process.wait(60) == 0
    device.kernel(*QUANTIZE)
    assert device._programs._first_builds._child is not child


@pytest.mark.parametrize("python", ["/no/such/python", "false"])
def test_programs_are_built_even_if_no_child_can_be_had(device, monkeypatch, tmp_path, python):
    monkeypatch.setattr(first_build.sys, "executable", python)
    device.kernel(*MASK)
    assert not notes(tmp_path)


def test_an_error_in_a_program_is_an_exception_as_before(device, monkeypatch):
    monkeypatch.setattr(programs, "read_program", lambda name: "__kernel void mask_apply( {}")
    with pytest.raises(DeviceError, match=r"mask\.cl does not build on"):
        device.kernel(*MASK)


@pytest.mark.slow
def test_every_program_is_built_and_the_broken_one_named(device, broken, monkeypatch):
    found = {file: (kernels, problem) for file, kernels, problem in device.build_all()}
    assert [file for file, (_, problem) in found.items() if problem] == ["loss/mask.cl"]
    kernels = [kernel.name for kernels, _ in found.values() for kernel in kernels]
    assert len(kernels) > 50
    assert "mask_apply" not in kernels
