"""A scene that chunks and layers are made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.scene_encoder import sort_anchors
from tests.codec.scenes import random_scene


@pytest.fixture(scope="package")
def scene():
    return random_scene(np.random.default_rng(9), 1500)


@pytest.fixture(scope="package")
def sorted_scene(scene):
    return replace(scene, anchors=sort_anchors(scene.anchors))
