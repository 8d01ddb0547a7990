"""scripts/accept_gpu.sh: drivers that OpenCL's loader has no list of."""

from __future__ import annotations

import os
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


def test_a_driver_is_found_where_the_loader_looks_first(tmp_path):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "libnvidia-opencl.so.1").touch()
    path = f"{tmp_path / 'none'}:{tmp_path / 'two'}:{tmp_path / 'one'}"
    assert str(tmp_path / "two" / "libnvidia-opencl.so.1") in libraries(LD_LIBRARY_PATH=path)
    assert not [one for one in libraries() if str(tmp_path) in one]


def test_devices_without_a_list_of_drivers(tmp_path):
    """The drivers of this machine alone, since the list that the loader is given is empty."""
    if not any(name.endswith("libpocl.so.2") for name in libraries()):
        pytest.skip("PoCL is not among the libraries of this machine's loader")
    wheels = tmp_path / "wheels"
    done = run("--devices", OCL_ICD_VENDORS=str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "Portable Computing Language" in done.stdout
    wheels.mkdir()
    done = run("--wheels", str(wheels), "--devices")
    assert done.returncode == 1
    assert f"{wheels}: holds no clgs-*.whl; make it with --collect" in done.stderr
