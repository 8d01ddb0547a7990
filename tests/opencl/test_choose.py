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
    max_work_group_size: int = 4096
    local_mem_size: int = 1 << 20
    single_fp_config: int = cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT


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
    ("platform", "name", "version", "serves"),
    [
        ("Portable Computing Language", "cpu", "3.0-rc2", False),
        ("Portable Computing Language", "cpu", "1.8", False),
        ("Portable Computing Language", "cpu", "3.1+debian", True),
        ("Portable Computing Language", "cpu", "10.0", True),
        ("Portable Computing Language", "cpu", "unknown", False),
        ("Intel(R) OpenCL", "AMD EPYC", "2026.22", True),
        ("Intel(R) FPGA Emulation Platform", "Intel(R) FPGA Emulation Device", "2026", False),
        ("rusticl", "llvmpipe (LLVM 15.0.6, 256 bits)", "22.3.6", False),
        ("Vendor CL", "cpu", "2.5", False),
    ],
)
def test_the_form_for_cpus_is_taken_on_drivers_that_it_is_known_to_serve(
    platform, name, version, serves
):
    device = FakeDevice(name, driver_version=version)
    FakePlatform(platform, [device])
    assert choose.serves_cpu_form(device) is serves


def test_a_stand_in_for_a_card_comes_after_every_cpu(machine):
    card = FakeDevice("llvmpipe (LLVM 15.0.6, 256 bits)", cl.device_type.GPU)
    cpu = FakeDevice("cpu", driver_version="2.5")
    machine(FakePlatform("rusticl", [card]), FakePlatform("Vendor CL", [cpu]))
    assert choose.choose_device() is cpu


@pytest.mark.parametrize(
    ("limits", "problem"),
    [
        ({"max_work_group_size": 128}, "hold 128 work-items at most, 256 are needed"),
        ({"local_mem_size": 16384}, "has 16384 bytes of local memory, 32768 are needed"),
        ({}, ""),
    ],
)
def test_what_a_device_lacks_is_said(machine, limits, problem):
    small, large = FakeDevice("small", **limits), FakeDevice("large")
    machine(FakePlatform("One", [small]), FakePlatform("Two", [large]))
    assert problem in choose.too_small(small)
    assert choose.choose_device() is (large if limits else small)


def test_two_drivers_of_one_card_are_distinguished(machine):
    cards = [FakeDevice("Radeon", cl.device_type.GPU) for _ in range(2)]
    machine(FakePlatform("AMD", [cards[0]]), FakePlatform("rusticl", [cards[1]]))
    with pytest.raises(DeviceError, match="0: Radeon AMD, 1: Radeon rusticl"):
        choose.choose_device("GeForce")
    assert choose.choose_device("rusticl") is cards[1]


def test_a_cpu_that_compiles_vectors_comes_first(machine):
    old = FakeDevice("old", driver_version="3.0-rc2")
    new = FakeDevice("new")
    pocl = "Portable Computing Language"
    machine(FakePlatform(pocl, [old]), FakePlatform(pocl, [new]))
    assert choose.choose_device() is new


def test_a_kind_is_what_bits_depend_on():
    """Models differ only where division is not rounded as IEEE 754 asks."""
    rough = {"type": cl.device_type.GPU, "single_fp_config": 0}
    a, b, x, y = (
        FakeDevice("a"),
        FakeDevice("b"),
        FakeDevice("x", **rough),
        FakeDevice("y", **rough),
    )
    FakePlatform("One", [a, b, x, y])
    other = FakeDevice("a")
    FakePlatform("Two", [other])
    assert choose.kind_of(a, "cpu") == choose.kind_of(b, "cpu")
    kinds = [choose.kind_of(each, "gpu") for each in (a, x, y, other)]
    assert len({*kinds, choose.kind_of(a, "cpu")}) == 5
