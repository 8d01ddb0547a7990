"""Matches between photos, found on the OpenCL device and verified by two-view geometries.

Two features match if each one's descriptor is the nearest to the other's, and much nearer than the
second nearest: Lowe's ratio test and a cross check, with COLMAP's limits.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations, groupby

import numpy as np
import numpy.typing as npt

from clgs.opencl.device import Device
from clgs.ops import match as nearest_descriptors
from clgs.ops.match import MAX_DESCRIPTORS, Descriptors, Nearest
from clgs.poses.evidence import LINKS, MIN_MATCHES, Evidence, MatchedPair
from clgs.poses.stages.verify import verify
from clgs.poses.workspace import Workspace

TILE = 12
"""Pairs are matched by two runs of TILE photos, so that few photos are uploaded twice."""

BATCH = 16
"""Pairs of a launch."""

MAX_ANGLE = 0.7
"""Largest angle between descriptors that match, radians; COLMAP's default."""

MAX_RATIO, LOOSE_RATIO = 0.8, 0.9
"""Largest angle over that to the second nearest; the first is COLMAP's default, the other one is
for the second look."""

MAX_SECOND_LOOK = 20
"""The most photos that are matched again with all others."""

LOOK_FEATURES = 1024
"""The largest features of a photo, by which a cheap look tells whether two photos share anything.

Wu, Towards Linear-time Incremental Structure from Motion, 2013: preemptive matching.
"""

FIRST_FEATURES, ENOUGH_MATCHES = 3072, 200
"""A pair is matched by this number of the largest features of each photo, and by all of them only
if one of the two photos has fewer matches than this in its best pairs, at the median."""

MAX_FULL = 25
"""Up to this number of photos pairs are matched by all features at once, which takes little time.
"""

MIN_ALIKE = 2
"""Matches of the cheap look that must agree on a turn and a change of scale."""

SAME_TURN, SAME_SCALE = np.radians(20.0), 0.6
"""What two matches agree within: radians, and the logarithm to base 2 of a scale."""

LOOK_BATCH = 500

Bytes = npt.NDArray[np.uint8]
Pair = tuple[int, int]
Matches = npt.NDArray[np.uint32]

# Of a product of descriptors, whose length is 512, the angle between them.
_ANGLE = np.arccos(np.minimum(np.arange(nearest_descriptors.MAX_PRODUCT) / 512**2, 1.0))


def match(workspace: Workspace, pairs: Sequence[Pair], first: int = FIRST_FEATURES) -> bool:
    """Match those pairs of photos that share something at a cheap look, and verify the matches.

    ``pairs`` are places in ``workspace.names``. The results are the same on every device. All
    features are used of few photos and of pairs with few matches, else the ``first`` largest.

    Returns:
        Whether that left features out.

    Raises:
        DataError: pycolmap fails.
        DeviceError: the device does.
    """
    strong, shortened = workspace.matches("matches", lambda: _find(workspace, pairs, first))
    workspace.matches("geometry", lambda: verify(workspace, strong, "geometry"))
    return bool(shortened)


def _find(
    workspace: Workspace, pairs: Sequence[Pair], first: int
) -> tuple[list[tuple[int, int]], bool]:
    """Match pairs, and write their matches.

    Returns:
        The images' numbers of the pairs with enough matches, and whether features were left out.
    """
    if len(workspace.names) <= MAX_FULL:
        first = MAX_DESCRIPTORS
    chosen = pairs_alike(workspace, pairs)
    count = workspace.counter("matches", len(pairs) - len(chosen), len(pairs))
    found = _match(workspace, chosen, MAX_RATIO, count, first)
    best = defaultdict[int, list[int]](list)
    for pair, matches in found.items():
        for place in pair:
            best[place].append(len(matches))
    thin = {
        place
        for place, counts in best.items()
        if np.median(sorted(counts, reverse=True)[:LINKS]) < ENOUGH_MATCHES
    }
    with workspace.open() as database:
        numbers = workspace.ids(database)
        rich = [database.num_keypoints_for_image(one) > first for one in numbers]
    again = [(a, b) for a, b in chosen if thin & {a, b} and (rich[a] or rich[b])]
    if again:
        count = workspace.counter("all features", 0, len(again))
        found |= _match(workspace, again, MAX_RATIO, count)
    shortened = any(rich[a] or rich[b] for a, b in set(chosen).difference(again))
    return _write(workspace, found), shortened


def match_in_full(workspace: Workspace, pairs: Sequence[Pair]) -> None:
    """Match pairs by all features, in place of the matches that there are."""
    with workspace.open() as database:
        database.clear_matches()
        database.clear_two_view_geometries()
    match(workspace, pairs, MAX_DESCRIPTORS)


def pairs_alike(workspace: Workspace, pairs: Sequence[Pair]) -> list[Pair]:
    """Select the pairs whose largest features agree on a turn and a change of scale."""
    with workspace.open() as database:
        features = [
            most_telling(database.read_keypoints(number), database.read_descriptors(number).data)
            for number in workspace.ids(database)
        ]
    count = workspace.counter("looks", 0, len(pairs))
    return alike(workspace.device, features, pairs, count)


def alike(
    device: Device,
    features: Sequence[tuple[npt.NDArray[np.float64], Bytes]],
    pairs: Sequence[Pair],
    on_looked: Callable[[int], None] = lambda count: None,
) -> list[Pair]:
    """Select the pairs whose largest features agree on a turn and a change of scale.

    features: of each photo, see :func:`most_telling`; ``on_looked`` receives the number of pairs
    that were looked at since its last call.
    """
    shapes, chosen = [shape for shape, _ in features], [one for _, one in features]
    uploaded, found = nearest_descriptors.upload(device, chosen), list[Pair]()
    for start in range(0, len(pairs), LOOK_BATCH):
        some = pairs[start : start + LOOK_BATCH]
        matched = mutual_matches(device, uploaded, chosen, some, MAX_RATIO)
        for (a, b), matches in zip(some, matched, strict=True):
            change = shapes[a][matches[:, 0]] - shapes[b][matches[:, 1]]
            between = change[:, None] - change
            turn = np.abs((between[..., 0] + np.pi) % (2 * np.pi) - np.pi)
            near = (turn <= SAME_TURN) & (np.abs(between[..., 1]) <= SAME_SCALE)
            if near.sum(1).max(initial=0) >= MIN_ALIKE:  # those that agree with one of them
                found.append((a, b))
        on_looked(len(some))
    return found


def most_telling(
    keypoints: npt.ArrayLike, descriptors: Bytes
) -> tuple[npt.NDArray[np.float64], Bytes]:
    """Turn and scale (M, 2), see :func:`turn_and_scale`, and descriptors of the largest features.

    keypoints, descriptors: (N, 6) and (N, 128) of a photo; M is at most LOOK_FEATURES.
    """
    shape = turn_and_scale(np.asarray(keypoints, np.float64))
    largest = np.argsort(-shape[:, 1], kind="stable")[:LOOK_FEATURES]
    return shape[largest], descriptors[largest]


def turn_and_scale(keypoints: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Compute (N, 2): orientation, radians, and logarithm to base 2 of the scale of each feature.

    keypoints: (N, 6), position and affine shape.
    """
    first = keypoints[:, [2, 4]]  # of the shape: the scale, turned by the orientation
    scale = np.log2(np.linalg.norm(first, axis=1))
    return np.stack([np.arctan2(first[:, 1], first[:, 0]), scale], 1)


def mutual_matches(
    device: Device,
    uploaded: Descriptors,
    photos: Sequence[Bytes],
    pairs: Sequence[Pair],
    ratio: float,
) -> list[Matches]:
    """Find the matches (M, 2) of each pair (a, b) of places in ``photos``, ascending by a's.

    photos: descriptors (N, 128) of each; uploaded: the same on the device; ratio: largest angle
    over that to the second nearest.
    """
    forth = nearest_descriptors.nearest(device, uploaded, uploaded, pairs)
    own = [np.flatnonzero(_distinct(one, ratio)) for one in forth]
    # Only what is matched one way is matched the other way.
    others = [np.unique(one.index[rows]) for one, rows in zip(forth, own, strict=True)]
    asked = [photos[b][rows] for (_, b), rows in zip(pairs, others, strict=True)]
    back = nearest_descriptors.nearest(
        device,
        nearest_descriptors.upload(device, asked),
        uploaded,
        [(place, a) for place, (a, _) in enumerate(pairs)],
    )
    found = []
    for one, rows, asked_rows, other in zip(forth, own, others, back, strict=True):
        columns = one.index[rows]
        place = np.searchsorted(asked_rows, columns)
        same = (other.index[place] == rows) & _distinct(other, ratio)[place]
        found.append(np.stack([rows[same], columns[same]], 1).astype(np.uint32))
    return found


def _distinct(found: Nearest, ratio: float) -> npt.NDArray[np.bool_]:
    nearest = _ANGLE[found.product]
    return np.asarray((nearest <= MAX_ANGLE) & (nearest < ratio * _ANGLE[found.second]))


def _match(
    workspace: Workspace,
    pairs: Sequence[Pair],
    ratio: float,
    on_matched: Callable[[int], None],
    features: int | None = None,
) -> dict[Pair, Matches]:
    """Match pairs by the largest ``features`` of each photo, None: by all of them.

    ``on_matched`` receives the number of pairs that were matched since its last call.
    """
    with workspace.open() as database:
        numbers = workspace.ids(database)

        def read(place: int) -> tuple[Matches, Bytes]:
            keypoints = np.asarray(database.read_keypoints(numbers[place]), np.float64)
            largest = np.argsort(-turn_and_scale(keypoints)[:, 1], kind="stable")
            rows = np.sort(largest[:features]).astype(np.uint32)
            return rows, database.read_descriptors(numbers[place]).data[rows]

        return dict(match_by_tiles(workspace.device, pairs, read, ratio, on_matched))


def match_by_tiles(
    device: Device,
    pairs: Sequence[Pair],
    read: Callable[[int], tuple[Matches, Bytes]],
    ratio: float,
    on_matched: Callable[[int], None],
) -> Iterator[tuple[Pair, Matches]]:
    """Match pairs of photos, a few of which are in memory at a time.

    ``read`` gives the numbers (N,) and the descriptors (N, 128) of the features of a photo that are
    used; ``ratio`` and ``on_matched``: see above.
    """
    for some in by_tiles(pairs):
        used = sorted({photo for pair in some for photo in pair})
        rows, photos = zip(*map(read, used), strict=True)
        uploaded = nearest_descriptors.upload(device, photos)
        for start in range(0, len(some), BATCH):
            batch = some[start : start + BATCH]
            local = [(used.index(a), used.index(b)) for a, b in batch]
            found = mutual_matches(device, uploaded, photos, local, ratio)
            for pair, (a, b), one in zip(batch, local, found, strict=True):
                yield pair, np.stack([rows[a][one[:, 0]], rows[b][one[:, 1]]], 1)
            on_matched(len(batch))


def _write(workspace: Workspace, found: Mapping[Pair, Matches]) -> list[tuple[int, int]]:
    """Write the matches of each pair that has enough of them; returns their images' numbers."""
    strong = []
    with workspace.open() as database:
        numbers = workspace.ids(database)
        for (a, b), matches in sorted(found.items()):
            if len(matches) >= MIN_MATCHES:
                database.write_matches(numbers[a], numbers[b], matches)
                strong.append((numbers[a], numbers[b]))
    return strong


def by_tiles(pairs: Sequence[Pair]) -> Iterator[list[Pair]]:
    """Group pairs so that each group is of few photos."""

    def tiles(pair: Pair) -> Pair:
        return pair[0] // TILE, pair[1] // TILE

    for _, some in groupby(sorted(pairs, key=lambda pair: (tiles(pair), pair)), tiles):
        yield list(some)


def match_again(workspace: Workspace, left_out: list[int]) -> None:
    """Match photos, by their place in ``workspace.names``, with all others, less strictly."""
    left_out = left_out[:MAX_SECOND_LOOK]
    chosen = set(left_out)
    every = combinations(range(len(workspace.names)), 2)
    pairs = [(i, j) for i, j in every if i in chosen or j in chosen]
    with workspace.open() as database:
        ids = workspace.ids(database)
        for first, second in ((ids[i], ids[j]) for i, j in pairs):
            if database.exists_matches(first, second):
                database.delete_matches(first, second)
            if database.exists_two_view_geometry(first, second):
                database.delete_two_view_geometry(first, second)
    stage = "second look"

    def find() -> list[tuple[int, int]]:
        count = workspace.counter(stage, 0, len(pairs))
        return _write(workspace, _match(workspace, pairs, LOOSE_RATIO, count))

    strong = workspace.matches(stage, find)
    workspace.matches(stage, lambda: verify(workspace, strong, stage))


def read_evidence(workspace: Workspace) -> Evidence:
    """Read all verified pairs of the database that have at least MIN_MATCHES matches."""
    with workspace.open() as database:
        keypoints = {
            number: np.asarray(database.read_keypoints(number), np.float64)[:, :2]
            for number in workspace.ids(database)
        }
        numbers, geometries = database.read_two_view_geometries()
    pairs = []
    for number, geometry in zip(numbers, geometries, strict=True):
        matches = np.asarray(geometry.inlier_matches, np.uint32).reshape(-1, 2)
        if len(matches) >= MIN_MATCHES:
            first, second = workspace.pycolmap.pair_id_to_image_pair(number)
            pairs.append(MatchedPair(first, second, matches))
    return Evidence(pairs, keypoints)
