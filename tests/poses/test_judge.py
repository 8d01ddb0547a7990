"""Every reason for a doubt; which photos are left out; when the whole scene is in doubt."""

from dataclasses import asdict, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from clgs.poses.evidence import (
    Evidence,
    Explained,
    MappedModel,
    MatchedPair,
    ModelChoice,
    PoseDifference,
    angle,
    poses_of,
)
from clgs.poses.judge import (
    is_ambiguous,
    judge,
    judge_photos,
    leave_out_parts,
    photo_figures,
)
from clgs.poses.stages.global_mapper import GLOBAL
from clgs.poses.stages.mapping import INCREMENTAL
from clgs.poses.verdict import DOUBTFUL, GOOD, LEFT_OUT, PhotoVerdict, verdict_of

SOUND = PhotoVerdict("", GOOD, 800, 0.97, 4.5, 0.6, 10.0, 8.0)
SAME, OTHER = PoseDifference(0.05, 0.1), PoseDifference(150.0, 40.0)
NAMES = [f"{number}.jpg" for number in range(12)]
AGREED = dict.fromkeys(NAMES, SAME)

PART = ["f.jpg", "g.jpg", "h.jpg"]
REST = ["a.jpg", "b.jpg", "c.jpg", "d.jpg"]

PHOTOS, MATCHES, TURNED = 40, 100, (3, 4)


def judged(changed: PhotoVerdict = SOUND, second: PoseDifference | None = SAME, rival=None):
    """The verdict on one photo among sound ones."""
    again = AGREED | {"5.jpg": second}
    if second is None:
        del again["5.jpg"]
    figures = {**dict.fromkeys(NAMES, SOUND), "5.jpg": changed}
    verdicts = judge_photos(figures, again, {"5.jpg": rival} if rival else {})
    assert {one.status for name, one in verdicts.items() if name != "5.jpg"} == {GOOD}
    return verdicts["5.jpg"]


def test_sound_photos_are_good():
    verdict = judged()
    assert (verdict.status, verdict.reasons, verdict.remedy) == (GOOD, (), "")
    assert verdict.turn == SAME.turn


@pytest.mark.parametrize(
    ("change", "second", "rival", "status", "reason"),
    [
        ({"observations": 30}, SAME, None, DOUBTFUL, "only 30 points"),
        ({"inlier_ratio": 0.4}, SAME, None, DOUBTFUL, "only 40 %"),
        ({"inlier_ratio": 0.1}, SAME, None, LEFT_OUT, "only 10 %"),
        ({"step": 90.0}, SAME, None, DOUBTFUL, "turned by 90 degrees"),
        ({}, PoseDifference(0.9, 0.1), None, DOUBTFUL, "turns it by 0.9"),
        ({}, PoseDifference(0.1, 3.0), None, DOUBTFUL, "shifts it by 3.0"),
        ({}, PoseDifference(80.0, 3.0), None, DOUBTFUL, "turns it by 80.0"),
        ({"observations": 59}, PoseDifference(80.0, 3.0), None, LEFT_OUT, "turns it by 80.0"),
        ({}, None, None, DOUBTFUL, "could not place it"),
        ({}, SAME, PoseDifference(120.0, 50.0), DOUBTFUL, "120 degrees apart"),
    ],
)
def test_every_doubt_has_a_reason_and_a_remedy(change, second, rival, status, reason):
    verdict = judged(replace(SOUND, **change), second, rival)
    assert verdict.status == status
    assert reason in "; ".join(verdict.reasons)
    assert verdict.remedy


@pytest.mark.parametrize(
    ("figures", "again"),
    [(replace(SOUND, step=70.0), AGREED), (SOUND, None)],
    ids=["photos without order", "not checked"],
)
def test_photos_that_are_all_alike_are_good(figures, again):
    verdicts = judge_photos(dict.fromkeys(NAMES, figures), again, {})
    assert {one.status for one in verdicts.values()} == {GOOD}


@pytest.mark.parametrize("name", [NAMES[0], NAMES[-1]])
def test_a_photo_at_an_end_of_the_walk_may_be_turned(name):
    figures = dict.fromkeys(NAMES, SOUND) | {name: replace(SOUND, step=90.0)}
    assert judge_photos(figures, AGREED, {})[name].status == GOOD


def test_if_too_many_had_to_go_all_stay_in_doubt():
    bad = replace(SOUND, inlier_ratio=0.1)
    figures = {name: bad if int(name[:-4]) < 5 else SOUND for name in NAMES}
    verdicts = judge_photos(figures, None, {})
    assert sum(one.status == DOUBTFUL for one in verdicts.values()) == 5


@pytest.mark.parametrize(
    ("statuses", "parts", "checked", "expected"),
    [
        ("ggggggg", [PART], True, []),  # the second reconstruction agrees
        ("ggggddd", [PART], True, PART),
        ("gggdgdd", [PART], True, PART),
        ("ggggggd", [PART], True, []),
        ("ddddddd", [PART], True, []),  # it is unknown which of both is wrong
        ("ggggddd", [], True, []),
        ("ggggddd", [["h.jpg"]], True, []),  # a photo is no part
        ("gggg", [PART], True, []),  # it was not joined
        # Without a second reconstruction nothing confirms a part.
        ("ggggggg", [PART], False, PART),
        ("ggggddd", [PART], False, PART),
        ("ddddggg", [PART], False, []),
        ("ggggggg", [["h.jpg"]], False, []),
        ("gggg", [PART], False, []),
    ],
)
def test_a_part_stays_only_if_it_is_confirmed(statuses, parts, checked, expected):
    known = {"g": PhotoVerdict("", GOOD), "d": PhotoVerdict("", DOUBTFUL, reasons=("a reason",))}
    before = {
        name: replace(known[letter], name=name)
        for name, letter in zip(REST + PART, statuses, strict=False)
    }
    found = leave_out_parts(before, parts, checked)
    assert [name for name, one in found.items() if one.status == LEFT_OUT] == expected
    for name, one in found.items():
        if name in expected:
            apart = "it and 2 others form a part of their own"
            assert one.reasons == (apart, *before[name].reasons)
            assert one.remedy
        else:
            assert one == before[name]


def counted(matches: list[int], found: list[int]) -> Explained:
    return Explained([], np.array(matches), np.array(found))


def test_contradicting_pairs():
    # Explained, contradicted, too few matches, one photo without a pose.
    assert counted([300, 100, 20, 500], [290, 5, 0, -1]).contradicted == 0.25
    assert counted([], []).contradicted == 0.0


def test_ambiguity():
    clear = counted([100] * 50, [90] * 50)
    assert not is_ambiguous(AGREED, {}, clear, 12)
    assert not is_ambiguous({"1.jpg": OTHER}, {}, clear, 12)
    assert is_ambiguous({"1.jpg": OTHER, "2.jpg": OTHER}, {}, clear, 12)
    assert is_ambiguous({"1.jpg": OTHER}, {"2.jpg": OTHER}, clear, 12)
    assert is_ambiguous(AGREED, {}, counted([100] * 50, [90] * 48 + [3] * 2), 12)
    assert not is_ambiguous(AGREED, {}, counted([100] * 50, [90] * 49 + [3]), 12)


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
    links = [MatchedPair(a, b, np.zeros((0, 2), np.uint32)) for a, b in pairwise(numbers)]
    found = [share if {one.first, one.second} & set(turned) else 1.0 for one in links]
    counts = np.full(len(links), MATCHES)
    return Explained(links, counts, np.round(counts * found).astype(np.int64))


def verdict_on(models: list[MappedModel], second: Any, checked: bool = True, apart=(), more=()):
    """The verdict on the first of these models, whose photos keep their names."""
    model = models[0].reconstruction
    names = [model.image(n).name for n in sorted(model.reg_image_ids())]
    choice = ModelChoice(models[0], models, Evidence([], {}), list(apart))
    return judge(choice, second, checked, [*names, *more])


def test_a_step_is_that_to_the_nearer_neighbour(pycolmap):
    model = synthetic(pycolmap)
    poses = poses_of(model)
    found = [one.step for one in photo_figures(model, poses, explained(model, 1.0)).values()]
    step = angle(poses.rotation[1:] @ np.swapaxes(poses.rotation[:-1], 1, 2))
    assert found == pytest.approx([step[0], *np.minimum(step[1:], step[:-1]), step[-1]])


@pytest.mark.parametrize(("share", "doubted"), [(0.2, True), (0.4, False)])
def test_none_is_good_if_the_best_matches_contradict_the_poses(pycolmap, share, doubted):
    """Three links across, which the poses explain badly; each photo has two that they explain."""
    model = synthetic(pycolmap)
    along, none = explained(model, 1.0), np.zeros((0, 2), np.uint32)
    numbers = sorted(model.reg_image_ids())
    across = [MatchedPair(numbers[i], numbers[i + 20], none) for i in (5, 9, 13)]
    found = [*along.explained, *[round(share * MATCHES)] * len(across)]
    links = [*along.links, *across]
    every = Explained(links, np.full(len(links), MATCHES), np.array(found, np.int64))
    verdict = verdict_on([MappedModel(INCREMENTAL, model, every)], model)
    assert verdict.ambiguous == doubted
    reasons = [photo.reasons for photo in verdict.of(DOUBTFUL)]
    reason = "7 % of the best matches of all photos contradict the poses"
    assert reasons == ([(reason,)] * PHOTOS if doubted else [])
    assert verdict_of(asdict(verdict)) == verdict


@pytest.mark.parametrize(("share", "heard"), [(0.9, True), (0.3, True), (0.2, False), (0.0, False)])
def test_another_mapper_is_heard_on_photos_whose_matches_it_explains(pycolmap, share, heard):
    kept, rival = synthetic(pycolmap), synthetic(pycolmap, TURNED)
    models = [
        MappedModel(INCREMENTAL, kept, explained(kept, 1.0)),
        MappedModel(GLOBAL, rival, explained(rival, share, TURNED)),
    ]
    verdict = verdict_on(models, kept)
    doubtful = [photo.name for photo in verdict.of(DOUBTFUL)]
    assert doubtful == ([kept.image(number).name for number in TURNED] if heard else [])
    assert verdict.ambiguous == heard
    assert verdict.sure.startswith("not sure" if heard else "sure")


def test_photos_without_a_pose_are_left_out_for_a_reason(pycolmap):
    model = synthetic(pycolmap)
    kept = MappedModel(INCREMENTAL, model, explained(model, 1.0))
    verdict = verdict_on([kept], None, False, [["x.jpg", "y.jpg"]], ["x.jpg", "y.jpg", "z.jpg"])
    assert (verdict.registered, verdict.total) == (PHOTOS, PHOTOS + 3)
    assert verdict.apart == (("x.jpg", "y.jpg"),)
    apart, alone = "it and 1 other form a part of their own", "it shares too little with the other"
    reasons = {photo.name: photo.reasons[0] for photo in verdict.of(LEFT_OUT)}
    assert list(reasons) == ["x.jpg", "y.jpg", "z.jpg"]
    assert reasons["x.jpg"] == reasons["y.jpg"] == apart
    assert reasons["z.jpg"].startswith(alone)
    assert verdict.sure.startswith("not checked: ")
