"""A program that imports pycolmap before Pillow is warned; the other order is quiet."""

import subprocess
import sys

import pytest

pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "warned"),
    [
        ("import PIL.Image, pycolmap, clgs; clgs.Camera", False),
        ("import pycolmap, clgs", True),
        ("import pycolmap, PIL.Image, clgs", True),
        ("import clgs, pycolmap; clgs.Camera", True),
        ("import clgs; clgs.Camera", False),
    ],
)
def test_the_order_that_crashes_is_named(code, warned):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0
    assert ("pycolmap was imported before Pillow" in done.stderr) == warned
