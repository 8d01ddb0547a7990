"""What tests of training share: a small data set, and the device with the CPU form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from clgs.data.dataset import Dataset, load_dataset
from clgs.train.config import TrainConfig
from clgs.train.run.load import with_points
from tests.small_scene import write_scene


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Twelve photos and three held-out ones of 40 x 40 pixels, 4,000 points."""
    whole = load_dataset(write_scene(tmp_path_factory.mktemp("balls")))
    return with_points(whole, TrainConfig(start_points=4000))


@pytest.fixture
def cpu(open_device: Callable[..., Any]) -> Any:
    """The device with the kernels' CPU form."""
    return open_device("cpu")
