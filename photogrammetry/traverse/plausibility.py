"""Stops and images with impossible telemetry.

A label can be well-formed and still place its rover kilometres from its true position, by a damaged
field or a wrong frame. One such stop in a network would distort the map, the links and every figure
of the mission, so it gets a separate map until its files are corrected.

The limits are physical and wide: wheel slip, gaps in deliveries and changes of the site frame are
far within them.

Of stops that contradict each other, the largest set in which each agrees with the next is kept; of
equal sets, the one nearest to the origin, because errors nearly always enlarge a coordinate. Images
of one stop are separated first: the majority is used, or, without a majority, those that agree with
the first one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, ObjectPoints
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId

Flags = np.ndarray
"""One truth value per stop."""

MOST_PER_SOL_M = 1000.0
"""Perseverance drove 411 m in its longest sol, Spirit and Opportunity 124 and 220 m."""
MOST_DRIFT = 0.2
"""Fraction of the distance from the origin: difference between telemetry and localised sites where
a chain changes between them. Wheels slip by up to 20 % over a whole traverse (more on single
drives, which the distance of a sol covers)."""
MOST_FROM_ORIGIN_M = 200_000.0
"""The longest traverse so far is 45 km; the map of the landing site is a plane tangent to Mars."""
MOST_TILT_DEG = 60.0
"""Rovers are kept below 30 degrees and tip over at 45."""
MOST_APART_M = 10.0
"""Largest distance between the images of one stop, at which a rover does not move; labels before
and after a localisation differ by the slip since its site was declared, some metres."""

MOST_TURN = 0.35
"""Difference of an element of the rotation matrix: about 20 degrees, more than a new sun sighting
changes."""


@dataclass(frozen=True, slots=True, eq=False)
class TelemetryStop:
    """Telemetry of a stop."""

    stop: StopId
    lsl_from_rover: Pose
    sols: tuple[int, ...]
    """Sols on which images were taken there, ascending."""


def implausible_stops(stops: Sequence[TelemetryStop]) -> dict[StopId, str]:
    """The stops with impossible poses, and why; `stops` in the order of the traverse."""
    reasons = {one.stop: reason for one in stops if (reason := _own_reason(one))}
    left = [one for one in stops if one.stop not in reasons]
    kept = np.flatnonzero(_largest_agreeing(left))
    for k in sorted(set(range(len(left))) - set(kept.tolist())):
        neighbours = [left[i] for i in (*kept[kept < k][-1:], *kept[kept > k][:1])]
        reasons[left[k].stop] = _jump_reason(left[k], neighbours)
    return reasons


def implausible_poses(poses: Sequence[Pose]) -> list[str | None]:
    """The reason why the label of each image of a stop is impossible; None for valid ones.

    Args:
        poses: Of the rover in its site, by the images in the order in which they were taken.
    """
    tilts_deg = [np.degrees(np.arccos(np.clip(pose.rotation[2, 2], -1.0, 1.0))) for pose in poses]
    values = np.array([[*pose.translation_m, *pose.rotation.ravel()] for pose in poses])
    limits = np.repeat([MOST_APART_M, MOST_TURN], [3, 9])
    upright = np.array(tilts_deg) <= MOST_TILT_DEG
    differ = np.zeros(len(poses), dtype=bool)
    if upright.any():
        differ = (np.abs(values - np.median(values[upright], axis=0)) > limits).any(axis=1)
        if 2 * differ[upright].sum() >= upright.sum():
            differ = (np.abs(values - values[upright][0]) > limits).any(axis=1)
    return [
        f"it has the rover tilted by {tilt_deg:.0f} degrees, but rovers tip over at "
        f"{MOST_TILT_DEG:.0f}"
        if not tilt_deg <= MOST_TILT_DEG
        else "it places the rover elsewhere than most images of the stop, or the first one"
        if is_elsewhere
        else None
        for tilt_deg, is_elsewhere in zip(tilts_deg, differ, strict=True)
    ]


def _own_reason(one: TelemetryStop) -> str | None:
    """The reason why a stop is impossible independent of its neighbours."""
    away_m = float(np.abs(one.lsl_from_rover.translation_m).max())
    if away_m <= MOST_FROM_ORIGIN_M:
        return None
    return (
        f"telemetry puts it {away_m:.4g} m from the origin of the map; no rover has driven "
        f"{MOST_FROM_ORIGIN_M / 1000:.0f} km"
    )


def _largest_agreeing(stops: Sequence[TelemetryStop]) -> Flags:
    """The stops to keep, so that each agrees with the next one kept."""
    count = len(stops)
    places = np.array([one.lsl_from_rover.translation_m for one in stops]).reshape(-1, 3)
    sols = np.array([(one.sols[0], one.sols[-1]) if one.sols else (0, 0) for one in stops])
    sols = sols.reshape(-1, 2).astype(np.float64)
    if _agree(places[:-1], sols[:-1], places[1:], sols[1:]).all():
        return np.ones(count, dtype=bool)
    away_m = np.linalg.norm(places, axis=1)
    worth = 1.0 - 0.5 * away_m / max(float(away_m.sum()), 1.0)
    best, before = worth.copy(), np.full(count, -1)
    for k in range(1, count):
        here = [k] * k
        fits = np.flatnonzero(_agree(places[:k], sols[:k], places[here], sols[here]))
        if len(fits):
            before[k] = fits[np.argmax(best[fits])]
            best[k] += best[before[k]]
    keep, k = np.zeros(count, dtype=bool), int(np.argmax(best))
    while k >= 0:
        keep[k], k = True, int(before[k])
    return keep


def _agree(
    earlier_m: ObjectPoints,
    earlier_sols: Float64[np.ndarray, "n 2"],
    later_m: ObjectPoints,
    later_sols: Float64[np.ndarray, "n 2"],
) -> Flags:
    """Whether the rover can have driven from each earlier position to its later one."""
    driving = 1.0 + np.maximum(0.0, later_sols[:, 0] - earlier_sols[:, 1])
    nearer_m = np.minimum(np.linalg.norm(earlier_m, axis=1), np.linalg.norm(later_m, axis=1))
    apart_m = np.linalg.norm(later_m - earlier_m, axis=1)
    return apart_m <= MOST_PER_SOL_M * driving + MOST_DRIFT * nearer_m


def _jump_reason(one: TelemetryStop, neighbours: Sequence[TelemetryStop]) -> str:
    here = one.lsl_from_rover.translation_m
    far = [
        f"{np.linalg.norm(here - other.lsl_from_rover.translation_m):,.0f} m from {other.stop}"
        for other in neighbours
    ]
    return (
        f"telemetry puts it {' and '.join(far)}, the stops beside it, farther than a rover drives "
        f"in the sols between ({MOST_PER_SOL_M:,.0f} m each)"
    )
