"""Fixtures of all tests: a device in both specialisations, shared data, a seeded generator."""

import importlib.util
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest

from tests import kernel_cache, mutant

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = importlib.util.find_spec("clgs")
if (ROOT / "clgs" / "__init__.py").is_file():  # else the package is a wheel's
    found = Path(PACKAGE.origin).resolve() if PACKAGE and PACKAGE.origin else None
    if found is None or not found.is_relative_to(ROOT):
        remedy = "activate the .venv of this checkout, or run ./scripts/setup.sh"
        pytest.exit(f"clgs is another copy, {found}, and not {ROOT / 'clgs'}; {remedy}", 4)

KERNELS = kernel_cache.open_cache()  # before pyopencl is imported

if mutant.VARIABLE in os.environ:
    mutant.apply(Path(os.environ[mutant.VARIABLE]))


os.environ["LANGUAGE"] = "C"  # else every parser of a command looks for its texts in 60 files


hypothesis.settings.register_profile("same", deadline=None, derandomize=True)
hypothesis.settings.register_profile("new", deadline=None)
hypothesis.settings.load_profile("same")  # --hypothesis-profile=new: other examples in every run


@pytest.fixture(scope="module", autouse=True)
def _shared_kernels() -> Iterator[None]:
    KERNELS.take()
    yield
    KERNELS.give()


@pytest.fixture(scope="session", autouse=True)
def _own_photos(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Reduced photos are kept apart from the user's."""
    os.environ["CLGS_CACHE"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="session")
def open_device() -> Callable[..., Any]:
    """``open_device("cpu")``: the device in one specialisation, opened once a session."""
    from clgs.opencl.device import Device

    opened: dict[str, Any] = {}

    def open_one(specialisation: str) -> Any:
        if specialisation not in opened:
            opened[specialisation] = Device(specialisation=specialisation)
        return opened[specialisation]

    return open_one


@pytest.fixture(scope="session", params=["cpu", pytest.param("gpu", marks=pytest.mark.slow)])
def device(request: pytest.FixtureRequest, open_device: Callable[..., Any]) -> Any:
    """The machine's device, with the kernels' CPU form and with their GPU form.

    Tests of the GPU form are slow ones, because conformance finds the same bits in both.
    """
    return open_device(request.param)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real captures next to the checkout (CLGS_SHARED_DATA names another)."""
    folder = Path(os.environ.get("CLGS_SHARED_DATA", SHARED_DATA))
    if not folder.is_dir():
        pytest.skip(f"no shared data: {folder} is missing")
    return folder


@pytest.fixture
def refusal(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """``refusal(code, *words)``: the one line that a command says, which ends with this code."""
    from tests.cli.calls import exit_code

    def refused(code: int, *words: object) -> str:
        capsys.readouterr()
        assert exit_code([str(word) for word in words]) == code
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1), out + err
        assert err.startswith("clgs: error: ")
        return err.removeprefix("clgs: error: ")

    return refused


@pytest.fixture
def output_of(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """``output_of(*words)``: what a command prints, which succeeds."""
    from tests.cli.calls import exit_code

    def printed(*words: object) -> str:
        capsys.readouterr()
        assert exit_code([str(word) for word in words]) == 0
        return capsys.readouterr().out

    return printed


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same in every run."""
    return np.random.default_rng(20240607)
