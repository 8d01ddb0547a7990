"""Choosing a device: by number, by name, by environment, and what counts as none."""

from __future__ import annotations

from dataclasses import dataclass, field

import pyopencl as cl
import pytest

from clgs.errors import DeviceError, UsageError
from clgs.opencl import choose


@dataclass(eq=False)
class FakeDevice:
    name: str
    type: int = cl.device_type.CPU
    available: bool = True
    compiler_available: bool = True
    platform: FakePlatform | None = None
    driver_version: str = "3.1+debian"
    host_unified_memory: bool = False


@dataclass(eq=False)
class FakePlatform:
    name: str
    devices: list[FakeDevice] = field(default_factory=list)
    error: bool = False

    def __post_init__(self):
        for device in self.devices:
            device.platform = self

    def get_devices(self):
        if self.error:
            raise cl.Error("clGetDeviceIDs failed: DEVICE_NOT_FOUND")
        return self.devices


@pytest.fixture
def machine(monkeypatch):
    """Call it with platforms; they are then the only ones, and no variable chooses."""
    monkeypatch.delenv("PYOPENCL_CTX", raising=False)

    def install(*platforms):
        monkeypatch.setattr(cl, "get_platforms", lambda: list(platforms))

    return install


@pytest.fixture
def busy_machine(machine):
    machine(
        FakePlatform("Clover"),
        FakePlatform("Broken", error=True),
        FakePlatform("Oclgrind", [FakeDevice("Oclgrind Simulator", cl.device_type.GPU)]),
        FakePlatform("Portable Computing Language", [FakeDevice("cpu-haswell i7")]),
        FakePlatform(
            "Vendor CL",
            [
                FakeDevice("Old Card", cl.device_type.GPU, available=False),
                FakeDevice("No Compiler", cl.device_type.GPU, compiler_available=False),
                FakeDevice(" Big Card ", cl.device_type.GPU),
                FakeDevice("Small Card", cl.device_type.GPU),
            ],
        ),
    )


def test_a_card_with_memory_of_its_own_comes_first(machine):
    shared = FakeDevice("In the CPU", cl.device_type.GPU, host_unified_memory=True)
    machine(
        FakePlatform("First", [FakeDevice("cpu"), shared]),
        FakePlatform("Second", [FakeDevice("Card", cl.device_type.GPU)]),
    )
    assert choose.choose_device().name == "Card"
    machine(FakePlatform("First", [FakeDevice("cpu"), shared]))
    assert choose.choose_device().name == "In the CPU"


@pytest.mark.usefixtures("busy_machine")
class TestBusyMachine:
    def test_platforms_that_raise_or_are_empty_do_not_count(self):
        names = [device.name.strip() for device in choose.list_devices()]
        assert names == ["Oclgrind Simulator", "cpu-haswell i7", "Big Card", "Small Card"]

    def test_what_is_left_out_has_a_line(self):
        assert choose.survey()[1] == [
            "platform Clover: no devices",
            "platform Broken: clGetDeviceIDs failed: DEVICE_NOT_FOUND",
            "Old Card (Vendor CL): not usable",
            "No Compiler (Vendor CL): not usable",
        ]

    def test_the_first_gpu_that_is_no_emulator_is_the_default(self):
        assert choose.choose_device().name == " Big Card "

    @pytest.mark.parametrize(
        ("wanted", "name"),
        [
            ("1", "cpu-haswell i7"),
            ("small", "Small Card"),
            ("PORTABLE", "cpu-haswell i7"),
            ("oclgrind", "Oclgrind Simulator"),
        ],
    )
    def test_by_number_or_name(self, wanted, name):
        assert choose.choose_device(wanted).name == name

    @pytest.mark.parametrize(
        ("variable", "name"),
        [
            ("1", "cpu-haswell i7"),
            ("2", " Big Card "),
            ("2:1", "Small Card"),
            ("vendor:small", "Small Card"),
            ("portable", "cpu-haswell i7"),
        ],
    )
    def test_by_environment(self, monkeypatch, variable, name):
        monkeypatch.setenv("PYOPENCL_CTX", variable)
        assert choose.choose_device().name == name

    def test_the_argument_wins_over_the_environment(self, monkeypatch):
        monkeypatch.setenv("PYOPENCL_CTX", "portable")
        assert choose.choose_device("small").name == "Small Card"

    @pytest.mark.parametrize("wanted", ["4", "7", "nvidia"])
    def test_an_unknown_device_is_an_error_that_lists_the_others(self, wanted):
        with pytest.raises(DeviceError) as caught:
            choose.choose_device(wanted)
        message = str(caught.value)
        assert f"--device {wanted}" in message
        assert "2: Big Card, 3: Small Card" in message
        assert "\n" not in message

    @pytest.mark.parametrize("wanted", ["", " "])
    def test_an_empty_name_is_wrong_usage(self, wanted):
        with pytest.raises(UsageError, match="--device: the name is empty"):
            choose.choose_device(wanted)

    @pytest.mark.parametrize("variable", ["9", "2:9", "amd", "portable:card"])
    def test_an_unknown_context_is_an_error(self, monkeypatch, variable):
        monkeypatch.setenv("PYOPENCL_CTX", variable)
        with pytest.raises(DeviceError, match=f"PYOPENCL_CTX={variable}"):
            choose.choose_device()


def assert_no_device():
    with pytest.raises(DeviceError) as caught:
        choose.choose_device()
    assert "\n" not in str(caught.value)
    assert "apt-get install pocl-opencl-icd" in str(caught.value)
    assert caught.value.exit_code == 4


def test_no_platform_is_no_device(machine):
    machine()
    assert_no_device()


def test_no_loader_is_no_device(monkeypatch):
    def fail():
        raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    monkeypatch.setattr(cl, "get_platforms", fail)
    assert_no_device()


def test_empty_platforms_are_no_device(machine):
    machine(FakePlatform("Clover"), FakePlatform("Broken", error=True))
    assert_no_device()


def test_an_emulator_is_taken_where_nothing_else_is(machine):
    machine(FakePlatform("Oclgrind", [FakeDevice("Oclgrind Simulator", cl.device_type.GPU)]))
    assert choose.choose_device().name == "Oclgrind Simulator"


@pytest.mark.parametrize(
    ("platform", "version", "vectors"),
    [
        ("Portable Computing Language", "3.0-rc2", False),
        ("Portable Computing Language", "1.8", False),
        ("Portable Computing Language", "3.1+debian", True),
        ("Portable Computing Language", "10.0", True),
        ("Portable Computing Language", "unknown", True),
        ("Vendor CL", "2.5", True),
    ],
)
def test_an_old_pocl_compiles_no_vectors(platform, version, vectors):
    device = FakeDevice("cpu", driver_version=version)
    FakePlatform(platform, [device])
    assert choose.compiles_vectors(device) is vectors


def test_a_cpu_that_compiles_vectors_comes_first(machine):
    old = FakeDevice("old", driver_version="3.0-rc2")
    new = FakeDevice("new")
    pocl = "Portable Computing Language"
    machine(FakePlatform(pocl, [old]), FakePlatform(pocl, [new]))
    assert choose.choose_device() is new
