"""The result of judging: figures and verdict of every photo, and how sure all poses are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

GOOD, DOUBTFUL, LEFT_OUT = "good", "doubtful", "left out"


@dataclass(frozen=True)
class PhotoVerdict:
    """The verdict on a photo, and its figures; unknown ones are None.

    name; status: GOOD, DOUBTFUL or LEFT_OUT; observations: points that it sees; inlier_ratio: share
    of its matches in links (``evidence.LINKS``) that the poses explain; track_length: mean number
    of photos that see its points; error: mean reprojection error, pixels; tilt: degrees from the
    median up-vector; step: degrees from its neighbours by name, the nearer of both; turn, shift:
    degrees by which a second reconstruction differs; reasons and remedy: of a doubt, else empty;
    source: path below the folder of photos, if the photo has another name there.
    """

    name: str
    status: str
    observations: int = 0
    inlier_ratio: float | None = None
    track_length: float | None = None
    error: float | None = None
    tilt: float | None = None
    step: float | None = None
    turn: float | None = None
    shift: float | None = None
    reasons: tuple[str, ...] = ()
    remedy: str = ""
    source: str = ""


@dataclass(frozen=True)
class Verdict:
    """The verdict on the whole reconstruction.

    registered: photos with a pose in the result, of total; points; observations; error: mean
    reprojection error, pixels; track_length: mean number of photos per point; mapper: the mapper of
    the model that was kept; explained: matches in links that each mapper's model explains; apart:
    names of photos of other models; photos: the verdicts on all photos, in the order of names;
    checked: whether a second reconstruction was to be made; ambiguous: whether the scene looks
    alike from several sides; contradicted: share of matches in links that contradict the poses;
    sure: one sentence on how sure the poses are; seconds: of each stage; notes: sentences on what
    was known of the poses before.
    """

    registered: int
    total: int
    points: int
    observations: int
    error: float
    track_length: float
    mapper: str
    explained: Mapping[str, int]
    apart: tuple[tuple[str, ...], ...]
    photos: tuple[PhotoVerdict, ...]
    checked: bool
    ambiguous: bool
    contradicted: float
    sure: str
    seconds: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def of(self, status: str) -> list[PhotoVerdict]:
        """Select the photos of this status."""
        return [photo for photo in self.photos if photo.status == status]


def point_figures(model: Any) -> dict[str, Any]:
    """Compute the fields of a verdict that count points, of a pycolmap reconstruction."""
    return {
        "points": model.num_points3D(),
        "observations": model.compute_num_observations(),
        "error": float(model.compute_mean_reprojection_error()),
        "track_length": float(model.compute_mean_track_length()),
    }


def verdict_of(plain: Mapping[str, Any]) -> Verdict:
    """Make a verdict of what ``dataclasses.asdict`` made of one, perhaps with lists for tuples."""
    photos = tuple(
        PhotoVerdict(**{**one, "reasons": tuple(one["reasons"])}) for one in plain["photos"]
    )
    apart = tuple(tuple(names) for names in plain["apart"])
    notes = tuple(plain.get("notes", ()))
    return Verdict(**{**plain, "photos": photos, "apart": apart, "notes": notes})
