"""scripts/accept_gpu.sh: drivers that OpenCL's loader has no list of."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "accept_gpu.sh"

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="a script for Linux")


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    plain = {k: v for k, v in os.environ.items() if not k.startswith(("OCL_ICD", "PYOPENCL"))}
    return subprocess.run(
        ["bash", SCRIPT, *arguments],
        env={**plain, **environment},
        capture_output=True,
        text=True,
    )


def libraries(**environment: str) -> list[str]:
    return run("--libraries", **environment).stdout.split()


def loadable() -> Path:
    """A library that any process can load."""
    return Path(importlib.util.find_spec("clgs._codec").origin)


def test_the_first_driver_that_loads_is_found(tmp_path):
    for folder in ("empty", "one", "two"):
        (tmp_path / folder).mkdir()
    (tmp_path / "empty" / "libnvidia-opencl.so.1").touch()
    for folder in ("one", "two"):
        shutil.copy(loadable(), tmp_path / folder / "libnvidia-opencl.so.1")
    path = ":".join(str(tmp_path / name) for name in ("none", "empty", "two", "one"))
    done = run("--libraries", LD_LIBRARY_PATH=path, PYTHON=sys.executable)
    assert str(tmp_path / "two" / "libnvidia-opencl.so.1") in done.stdout.split()
    assert "empty/libnvidia-opencl.so.1: file too short" in done.stderr
    assert not [one for one in libraries() if str(tmp_path) in one]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--wheels",), "--wheels needs a folder"),
        (("--wheels", "/nowhere"), "/nowhere: no such folder"),
        (("--collect",), "--collect needs a folder"),
        (("--collect", "x", "9.x"), "9.x: expected a version of Python such as 3.12"),
    ],
)
def test_wrong_words_are_a_line(tmp_path, words, complaint):
    done = run(*words)
    assert done.returncode == 2
    assert complaint in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.slow
def test_devices_without_a_list_of_drivers(tmp_path):
    """The drivers of this machine alone, since the list that the loader is given is empty."""
    if not any(name.endswith("libpocl.so.2") for name in libraries()):
        pytest.skip("PoCL is not among the libraries of this machine's loader")
    wheels = tmp_path / "wheels"
    done = run("--devices", OCL_ICD_VENDORS=str(tmp_path), PYTHON=sys.executable)
    assert done.returncode == 0, done.stderr
    assert "Portable Computing Language" in done.stdout
    wheels.mkdir()
    done = run("--wheels", str(wheels), "--devices")
    assert done.returncode == 1
    assert f"{wheels}: holds no clgs-*.whl; make it with --collect" in done.stderr
