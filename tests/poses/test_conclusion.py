"""From models to the verdict: when another mapper's model is heard."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from clgs.poses.judging.conclusion import conclude
from clgs.poses.judging.evidence import Evidence, Explained, Pair
from clgs.poses.judging.verdict import DOUBTFUL
from clgs.poses.models import GLOBAL, INCREMENTAL, Choice, Model

PHOTOS, MATCHES, TURNED = 40, 100, (3, 4)


@pytest.fixture(scope="module")
def pycolmap() -> Any:
    return pytest.importorskip("pycolmap", reason="pycolmap is not installed")


def synthetic(pycolmap: Any, turned: tuple[int, ...] = ()) -> Any:
    """A model of 40 photos, some of which look the other way; the same points in each call."""
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig = 1, PHOTOS
    model = pycolmap.synthesize_dataset(options)
    back = pycolmap.Rotation3d(np.diag([-1.0, 1.0, -1.0]))
    for number in turned:
        frame = model.image(number).frame
        pose = frame.rig_from_world
        frame.rig_from_world = pycolmap.Rigid3d(back * pose.rotation, pose.translation)
    return model


def explained(model: Any, share: float, turned: tuple[int, ...] = ()) -> Explained:
    """Links of all photos with the next: ``share`` of those of turned photos, all others whole."""
    numbers = sorted(model.reg_image_ids())
    none = np.zeros((0, 2), np.uint32)
    links = [Pair(a, b, none) for a, b in pairwise(numbers)]
    found = [share if {one.first, one.second} & set(turned) else 1.0 for one in links]
    counts = np.full(len(links), MATCHES)
    return Explained(links, counts, np.round(counts * found).astype(np.int64))


@pytest.mark.parametrize(("share", "doubted"), [(0.2, True), (0.4, False)])
def test_none_is_good_if_the_best_matches_contradict_the_poses(pycolmap, share, doubted):
    """Three links across, which the poses explain badly; each photo has two that they explain."""
    model = synthetic(pycolmap)
    along, none = explained(model, 1.0), np.zeros((0, 2), np.uint32)
    numbers = sorted(model.reg_image_ids())
    across = [Pair(numbers[i], numbers[i + 20], none) for i in (5, 9, 13)]
    found = [*along.explained, *[round(share * MATCHES)] * len(across)]
    links = [*along.links, *across]
    every = Explained(links, np.full(len(links), MATCHES), np.array(found, np.int64))
    kept = Model(INCREMENTAL, model, every)
    names = {model.image(number).name: model.image(number).name for number in numbers}
    verdict = conclude(Choice(kept, [kept], Evidence([], {}), []), model, True, names)
    assert verdict.ambiguous == doubted
    reasons = [photo.reasons for photo in verdict.of(DOUBTFUL)]
    reason = "7 % of the best matches of all photos contradict the poses"
    assert reasons == ([(reason,)] * PHOTOS if doubted else [])


@pytest.mark.parametrize(("share", "heard"), [(0.9, True), (0.3, True), (0.2, False), (0.0, False)])
def test_another_mapper_is_heard_on_photos_whose_matches_it_explains(pycolmap, share, heard):
    kept, rival = synthetic(pycolmap), synthetic(pycolmap, TURNED)
    models = [
        Model(INCREMENTAL, kept, explained(kept, 1.0)),
        Model(GLOBAL, rival, explained(rival, share, TURNED)),
    ]
    names = {kept.image(number).name: kept.image(number).name for number in kept.reg_image_ids()}
    choice = Choice(models[0], models, Evidence([], {}), [])
    verdict = conclude(choice, kept, True, names)
    doubtful = [photo.name for photo in verdict.of(DOUBTFUL)]
    assert doubtful == ([kept.image(number).name for number in TURNED] if heard else [])
    assert verdict.ambiguous == heard
    assert verdict.sure.startswith("not sure" if heard else "sure")
