"""The machine: why there is no device, in words that help."""

import json
import os
import sys
from pathlib import Path

import pytest

from clgs.doctor import ERROR, WARNING, machine
from clgs.doctor.machine import examine_machine
from clgs.machine import available_memory
from clgs.opencl import choose
from tests.terminal import python


@pytest.mark.slow
def test_a_device_passes_and_the_machine_is_described(output_of, monkeypatch):
    once = examine_machine()
    monkeypatch.setattr("clgs.doctor.machine.examine_machine", lambda: once)
    document = json.loads(output_of("doctor", "--json"))
    assert document["devices"][0]["checks"] >= 1
    assert document["devices"][0]["worst"] <= 1
    assert {"system", "processor", "memory", "disk", "versions"} == set(document["machine"])
    assert all(one["level"] != ERROR for one in document["findings"])
    assert "checks passed" in output_of("doctor")


@pytest.fixture
def no_packages(monkeypatch):
    """They are imported in processes of their own, which takes most of an examination."""
    monkeypatch.setattr(machine, "OPTIONAL", {})


@pytest.fixture
def pocl_alone():
    names = [device.platform.name for device in choose.list_devices()]
    if set(names) != {"Portable Computing Language"} or not choose.drivers():
        pytest.skip("needs PoCL from the system, and no other driver")


@pytest.mark.slow
@pytest.mark.usefixtures("pocl_alone")
def test_an_unwritable_cache_is_named(tmp_path):
    (tmp_path / "file").touch()
    done = python("-m", "clgs", "devices", POCL_CACHE_DIR=str(tmp_path / "file" / "kcache"))
    assert done.returncode == 4
    assert len(done.stderr.splitlines()) == 1
    assert "PoCL cannot keep its kernels" in done.stderr
    assert "set POCL_CACHE_DIR" in done.stderr
    done = python("-m", "clgs", "doctor", POCL_CACHE_DIR=str(tmp_path / "file" / "kcache"))
    assert done.returncode == 4
    assert "error    OpenCL: PoCL cannot keep its kernels" in done.stdout


@pytest.mark.slow
@pytest.mark.usefixtures("pocl_alone")
def test_drivers_that_are_not_named_or_do_not_load(tmp_path):
    done = python("-m", "clgs", "doctor", OCL_ICD_VENDORS=str(tmp_path))
    assert done.returncode == 4
    assert f"{tmp_path} names no driver" in done.stdout
    (tmp_path / "broken.icd").write_text("libnothing.so.1\n")
    (tmp_path / "empty.icd").touch()
    done = python("-m", "clgs", "devices", OCL_ICD_VENDORS=str(tmp_path))
    assert done.returncode == 4
    assert "broken.icd: libnothing.so.1: libnothing.so.1: cannot open" in done.stderr
    assert "empty.icd" in done.stderr


@pytest.mark.usefixtures("no_packages")
def test_a_device_that_computes_wrongly_is_an_error(monkeypatch):
    monkeypatch.setattr(machine, "device_errors", lambda device: [("scan", 2.0, 1.0)])
    monkeypatch.setattr("clgs.opencl.device.Device.build_all", lambda device: iter(()))
    found = examine_machine()
    assert not found.devices
    assert any("scan: error 2.0e+00" in one.problem for one in found.findings)


@pytest.mark.skipif(os.name == "nt", reason="no such signals")
@pytest.mark.parametrize(
    ("source", "problem"),
    [
        ("import os; os.abort()", "its import ends by signal 6"),
        ("raise OSError('no libX here')", "OSError: no libX here"),
    ],
)
def test_a_package_that_cannot_be_loaded_is_found(tmp_path, monkeypatch, source, problem):
    (tmp_path / "pycolmap.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(machine, "OPTIONAL", {"pycolmap": machine.OPTIONAL["pycolmap"]})
    monkeypatch.setattr(machine, "_devices", lambda: iter(()))  # which have tests of their own
    (found,) = [one for one in examine_machine().findings if one.where == "pycolmap"]
    assert found.level == WARNING
    assert found.problem.startswith(f"cannot be loaded ({problem}); it is needed for clgs prepare")
    assert found.remedy == "pip install --force-reinstall pycolmap"


@pytest.mark.usefixtures("no_packages")
@pytest.mark.parametrize("variable", ["CLGS_LANES", "CLGS_SPECIALISATION"])
def test_a_variable_that_says_nothing_known_is_to_be_corrected(monkeypatch, variable):
    monkeypatch.setenv(variable, "9")
    found = [one for one in examine_machine().findings if one.level == ERROR]
    assert found
    for one in found:
        assert one.problem.startswith(f"{variable}=9: is not ")
        assert one.remedy == "correct or unset it"


def test_the_cache_follows_its_variables(monkeypatch):
    monkeypatch.setenv("POCL_CACHE_DIR", "/a")
    assert choose.pocl_cache() == Path("/a")
    monkeypatch.delenv("POCL_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", "/b")
    assert choose.pocl_cache() == Path("/b/pocl/kcache")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/c")
    assert choose.pocl_cache() == Path("/c/.cache/pocl/kcache")


def test_memory_is_known_on_linux():
    if not sys.platform.startswith("linux"):
        assert available_memory() is None
    else:
        assert (available_memory() or 0) > 0


@pytest.mark.slow
@pytest.mark.usefixtures("no_packages")
def test_a_program_that_does_not_build_is_named(monkeypatch):
    from clgs.opencl import programs

    read = programs.read_program
    text = "__kernel void mask_apply( {}"
    monkeypatch.setattr(
        programs, "read_program", lambda name: text if name == "loss/mask.cl" else read(name)
    )
    found = [one for one in machine.examine_machine().findings if one.level == machine.ERROR]
    assert any("kernels_cl/loss/mask.cl does not build on" in one.problem for one in found)
