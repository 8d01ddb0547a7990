"""The demonstration's modules live in scripts/demo and import each other by their plain names."""

import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "scripts" / "demo"
sys.path.insert(0, str(FOLDER))


@pytest.fixture(scope="session")
def gallery():
    """The demonstration's scene."""
    pytest.importorskip("embreex")
    import scene

    return scene.build()
