"""Conjugates of interest points of one single image in another of the same stop.

First some of them are searched along their whole epipolar segments (`two_views`): up to 70 pixels
long for a baseline of 9 cm and ground 1.5 m from a Navcam, and as wide as pointing errors. Those
that correlate and agree with the geometry of the two cameras determine their relative rotation and
the inverse depth of the ground; with both, all interest points are searched again, in a window as
wide as the relief.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import KDTree

from solmap.photogrammetry.arrays import Float64, ImagePoints, PerPoint, Vector3
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.conjugates import (
    ConjugateParams,
    Conjugates,
    View,
    find_conjugates,
)
from solmap.photogrammetry.matching.parallax_planes import calibration_matrix
from solmap.photogrammetry.matching.records import MatchedPair
from solmap.photogrammetry.matching.single.two_views import (
    TwoViewCheck,
    TwoViews,
    check_conjugates,
    rotation_matrix,
)
from solmap.photogrammetry.matching.stereo.interest_points import (
    FoerstnerParams,
    interest_points,
    strongest_by_cell,
    subpixel_places,
)
from solmap.photogrammetry.matching.stereo.verification import VerificationParams
from solmap.photogrammetry.ranges import Count, NearestMetres, PixelsOrZero, Radians, WholePixels

FirstMatches = tuple[Float64[np.ndarray, "first 2"], Float64[np.ndarray, " first"]]
"""Image points found at the first search, and their inverse depth, per metre."""

REACH_SIGMAS = 3.0

TOGETHER = 128
"""Points with similar search windows that are processed together."""

NEIGHBOURS = 8
"""Matches around a point that determine its depth."""


RELIEF_PX = 4
"""Half the window of the second search: relief between neighbouring matches."""


LEAST_BASE_M = 0.01
"""Least distance between the cameras: at less, as for two filters, images do not determine
depth."""


@dataclass(frozen=True, slots=True)
class MonoParams:
    """How single images of a stop are matched."""

    interest: FoerstnerParams = field(default_factory=FoerstnerParams)
    conjugates: ConjugateParams = field(default_factory=lambda: ConjugateParams(half_px=8))
    verification: VerificationParams = field(default_factory=VerificationParams)
    pointing_sigma: Radians = 0.0026
    """Radians (0.15 degrees) per axis and image, as in `alignment`."""
    nearest_m: NearestMetres = 1.5
    """Nearest ground: the height of the mast."""
    first_points: Count = 400
    """Interest points of the first search, over all depths."""
    candidates: Count = 2500
    """Interest points of the overlap searched with known depth and rotation."""
    cell_px: WholePixels = 32
    """Cell of which the strongest points are taken in turn."""
    least_parallax_px: PixelsOrZero = 1.0
    """Parallax along the epipolar line. At less, the rays of the adjusted images may diverge, and a
    point behind infinity cannot be placed."""
    least_ties: Count = 12
    """Four times the three unknowns of the rotation: with fewer there is no link."""

    def __post_init__(self) -> None:
        if not (self.candidates >= self.first_points >= self.least_ties > 2):  # noqa: PLR2004
            raise MatchingError(
                "single images need candidates >= first_points >= least_ties > 2, not "
                f"{self.candidates}, {self.first_points}, {self.least_ties}"
            )
        if not (self.pointing_sigma > 0 and self.nearest_m > 0):
            raise MatchingError("pointing_sigma and nearest_m must be above zero")


@dataclass(frozen=True, slots=True, eq=False)
class SingleView:
    """An image without stereo partner, resampled to the geometry of `cameras.single`."""

    image_id: str
    geometry: EpipolarPair
    view: View


def select_candidates(
    one: SingleView, other: SingleView, two_views: TwoViews, params: MonoParams
) -> ImagePoints:
    """Interest points whose epipolar segment may be in the other image, spread out, best first."""
    margin = params.conjugates.half_px
    found = interest_points(one.view.image, one.view.mask, params.interest, margin)
    points = subpixel_places(one.view.image, found.pixels, params.interest)
    middle = two_views.project(points, np.full(len(points), 0.5 / params.nearest_m))
    far = two_views.project(points, np.zeros(len(points)))
    seen = other.geometry.shows(middle) | other.geometry.shows(far)
    points, weight = points[seen], found.weight[seen]
    return points[strongest_by_cell(points, weight, params.cell_px, params.candidates)]


def search_all_depths(
    one: SingleView, other: SingleView, two_views: TwoViews, points: ImagePoints, params: MonoParams
) -> tuple[FirstMatches, Vector3] | None:
    """((points, inverse depths), rotation of the other camera) from a search over all depths."""
    nothing = np.zeros(len(points))
    nearest = nothing + 1.0 / params.nearest_m
    length = np.linalg.norm(
        two_views.project(points, nearest) - two_views.project(points, nothing), axis=1
    )
    wide = np.ceil(length / 2 + _reach_px(two_views, params))
    inside = np.isfinite(wide)
    points, wide = points[inside], wide[inside]
    maps = _maps(two_views, points, nearest[inside] / 2, np.zeros(3))
    found = _find(one, other, points, maps, wide, params.conjugates)
    points, seen = points[found.found], found.points[found.found]
    if len(points) < params.least_ties:
        return None
    checked = check_pair(two_views, points, seen, params)
    if checked.agrees.sum() < params.least_ties:
        return None
    points, seen = points[checked.agrees], seen[checked.agrees]
    return (points, _inverse_depth(two_views, points, seen, checked.turn)), checked.turn


def search_near_depth(  # noqa: PLR0913, PLR0917 - two images, what is looked for, and what is known
    one: SingleView,
    other: SingleView,
    two_views: TwoViews,
    points: ImagePoints,
    near: FirstMatches,
    turn: Vector3,
    params: MonoParams,
) -> Conjugates:
    """Conjugates of all points near the depth of their neighbours."""
    _, nearest = KDTree(near[0]).query(points, k=min(NEIGHBOURS, len(near[0])))
    depth = np.median(near[1][nearest], axis=1)
    maps = _maps(two_views, points, depth, turn)
    reach = np.full(len(points), float(RELIEF_PX))
    return _find(one, other, points, maps, reach, params.conjugates)


def matches_in_view(
    pair: MatchedPair, view: SingleView, two_views: TwoViews, params: MonoParams
) -> np.ndarray:
    """Rows of a pair's matches that a single image shows by its label; the most certain first."""
    matches = pair.matches
    seen = two_views.project(matches.left, _inverse_depth_of(two_views, matches.parallax_px))
    rows = np.flatnonzero(view.geometry.shows(seen))
    order = strongest_by_cell(
        matches.left[rows], -matches.sigma_px[rows], params.cell_px, params.candidates
    )
    return rows[order]


def search_predicted(
    one: SingleView,
    other: SingleView,
    two_views: TwoViews,
    points: ImagePoints,
    parallax_px: PerPoint,
    params: MonoParams,
) -> Conjugates:
    """Conjugates of a pair's points, searched as far as pointing errors may move them."""
    maps = _maps(two_views, points, _inverse_depth_of(two_views, parallax_px), np.zeros(3))
    reach = np.full(len(points), np.ceil(_reach_px(two_views, params)))
    return _find(one, other, points, maps, reach, params.conjugates)


def _inverse_depth_of(two_views: TwoViews, parallax_px: PerPoint) -> PerPoint:
    """Inverse depth by the parallax of the first image's pair."""
    return parallax_px / (two_views.one.focal_px * two_views.one.base_m)


def check_pair(
    two_views: TwoViews, points: ImagePoints, seen: ImagePoints, params: MonoParams
) -> TwoViewCheck:
    """Which conjugates agree with the geometry of the two images."""
    return check_conjugates(
        two_views, points, seen, params.nearest_m, params.pointing_sigma, params.verification
    )


def _reach_px(two_views: TwoViews, params: MonoParams) -> float:
    """Displacement of a conjugate by pointing errors of both images."""
    focal = min(two_views.one.focal_px, two_views.other.focal_px)
    return REACH_SIGMAS * np.sqrt(2.0) * params.pointing_sigma * focal


def _maps(
    two_views: TwoViews, points: ImagePoints, inverse_depth: PerPoint, turn: Vector3
) -> Float64[np.ndarray, "n 3 3"]:
    """Maps of one image to the other over a plane at each point's depth, facing the camera."""
    pose = two_views.other_from_one
    plane = np.zeros((len(points), 3, 3))
    plane[:, :, 2] = inverse_depth[:, None] * pose.translation_m
    between = rotation_matrix(turn).T @ (pose.rotation + plane)
    return (
        calibration_matrix(two_views.other)
        @ between
        @ np.linalg.inv(calibration_matrix(two_views.one))
    )


def _find(
    one: SingleView,
    other: SingleView,
    points: ImagePoints,
    maps: Float64[np.ndarray, "n 3 3"],
    reach: PerPoint,
    params: ConjugateParams,
) -> Conjugates:
    """Conjugates within each point's own reach; those of similar reach are processed together."""
    order = np.argsort(reach, kind="stable")
    parts = [order[k : k + TOGETHER] for k in range(0, len(order), TOGETHER)]
    found = [
        find_conjugates(
            one.view, other.view, points[part], maps[part], int(reach[part].max()), params
        )
        for part in parts
    ]
    back = np.argsort(order, kind="stable")
    columns = ("found", "points", "sigma_px", "correlation", "spread")
    return Conjugates(*(np.concatenate([getattr(f, c) for f in found])[back] for c in columns))


def _inverse_depth(
    two_views: TwoViews, points: ImagePoints, seen: ImagePoints, turn: Vector3
) -> PerPoint:
    """Inverse depth at which a point is nearest to its measured position; at least 0, at infinity.

    The segment is straight and nearly even in q: a secant, then two Newton steps.
    """
    q, step = np.zeros(len(points)), 1e-3 / two_views.base_m
    for _ in range(3):
        here = two_views.project(points, q, turn)
        slope = (two_views.project(points, q + step, turn) - here) / step
        change = ((seen - here) * slope).sum(axis=1) / np.maximum((slope**2).sum(axis=1), 1e-12)
        q = np.maximum(q + np.nan_to_num(change), 0.0)
    return q
