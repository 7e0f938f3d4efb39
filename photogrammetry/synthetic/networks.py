"""Image networks with known truth: no images, only simulated measurements.

A rover with Navcam-like stereo pairs (45 degrees, 1024 pixels, baseline of 0.2 m, 1.5 m above the
ground) drives over gently rolling ground and takes a panorama at each stop. Telemetry reports every
drive with an error of wheel odometry, an azimuth that drifts and a noisy tilt; mast pointing has a
small error per pair. All errors are normal with the standard deviations of `AdjustmentParams`,
unless `TelemetryErrors` gives others, so that the statistics of an adjustment can be tested.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from solmap.photogrammetry.adjustment.model.network import Network, PairGeometry, StopPrior
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.model.small_matrices import rotation_of_vector
from solmap.photogrammetry.adjustment.model.telemetry import mast_partials
from solmap.photogrammetry.arrays import Float64, ImagePoints, ObjectPoints, PerPoint
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose, rotation_of_roll_pitch_yaw
from solmap.photogrammetry.imagery import StopId, TiePoints

LINES = 1024
FOCAL_PX = 1236.0
BASE_M = 0.2
MAST_M = 1.5
ELEVATION_DEG = -18.0
"""Number of points that all pairs of a panorama see."""
RANGE_M = 60.0
"""Farthest tie point: a parallax of about four pixels."""


@dataclass(frozen=True, slots=True)
class TelemetryErrors:
    """Standard deviations of telemetry errors, and systematic slip."""

    slip: float = 0.1
    position_floor_m: float = 0.1
    tilt_deg: float = 0.3
    azimuth_step_deg: float = 2.0
    pointing_deg: float = 0.1
    azimuth_fine_deg: float = 1.0
    mean_slip: float = 0.0
    """Slip of the wheels, as a fraction of each drive."""
    drive_slips: tuple[float, ...] = ()
    """Slip of each drive, if it is not common to all."""
    mast_deg: float = 0.0
    """Elevation zero and tilts of the azimuth axis, the same for all pairs of all stops."""

    @classmethod
    def assumed_by(cls, params: AdjustmentParams) -> TelemetryErrors:
        """The errors assumed by an adjustment with these parameters."""
        return cls(
            params.slip,
            params.position_floor_m,
            params.tilt_deg,
            params.azimuth_step_deg,
            params.pointing_deg,
            params.azimuth_fine_deg,
            mast_deg=params.mast_deg,
        )


@dataclass(frozen=True, slots=True, eq=False)
class NetworkTruth:
    """The truth of a simulated network."""

    lsl_from_rover: tuple[Pose, ...]
    pointings: Float64[np.ndarray, "pairs 3"]
    points: ObjectPoints
    blunders: Float64[np.ndarray, " rows"]
    """Size of the blunder added to each observation, pixels; zero for good ones."""
    blunders_px: Float64[np.ndarray, "rows 3"]
    """Blunder in sample, line and parallax."""


def numbered_stop(k: int) -> StopId:
    """The name of a stop by its number: fifty per site."""
    return StopId("TEST", 1 + k // 50, 10 * (k % 50))


def numbered_pair(stop: int, k: int) -> str:
    """The name of a pair by the number of its stop and its own."""
    return f"S{stop:04d}P{k:02d}"


def simulate_network(  # noqa: PLR0913 - one keyword for each thing that a test may vary
    rng: np.random.Generator,
    *,
    stops: int = 3,
    pairs_per_stop: int = 10,
    cross_ties: int = 20,
    far_cross_ties: int = 6,
    inter_ties: int = 40,
    intra_ties: int = 20,
    spacing_m: float = 20.0,
    sigma_px: float = 0.3,
    tie_noise: float = 1.0,
    errors: TelemetryErrors | None = None,
    blunders: float = 0.0,
    noise: float = 1.0,
    loop: bool = False,
    laps: int = 1,
    fine_every: int = 0,
    untied: AbstractSet[int] = frozenset(),
    stop_name: Callable[[int], StopId] = numbered_stop,
    pair_name: Callable[[int, int], str] = numbered_pair,
) -> tuple[Network, NetworkTruth]:
    """A traverse with simulated telemetry and matching.

    Args:
        rng: source of all randomness.
        stops: how many.
        pairs_per_stop: pairs of a panorama, at equal angles.
        cross_ties: ties between each stop and the next.
        far_cross_ties: ties between each stop and the one after the next.
        inter_ties: ties between neighbouring pairs of a stop.
        intra_ties: ties inside single pairs, per stop.
        spacing_m: length of a drive.
        sigma_px: of every image coordinate and parallax, as matching states it.
        tie_noise: factor on the errors of image coordinates and parallaxes.
        errors: of the telemetry; those that `AdjustmentParams` assumes by default.
        blunders: fraction of cross-site observations of wrong points.
        noise: multiplies all errors; 0 gives a consistent network.
        loop: bend the traverse into a circle, so that the last stops are at the first ones
            again.
        laps: times that a loop is driven; each stop is tied to the one a lap before.
        fine_every: the interval in stops of measured azimuths (FINE); 0: never.
        untied: drives without ties, by the number of the stop at which they end.
        stop_name: of a stop by its number.
        pair_name: of a pair by the number of its stop, and its own in the panorama.
    """
    errors = errors or TelemetryErrors()
    truth = _traverse(rng, [stop_name(k) for k in range(stops)], spacing_m, laps if loop else 0)
    telemetry = _telemetry(rng, truth, errors, noise, fine_every)
    pairs = tuple(
        pair
        for k in range(stops)
        for pair in _panorama(stop_name(k), [pair_name(k, i) for i in range(pairs_per_stop)])
    )
    pointings = rng.normal(0, np.radians(errors.pointing_deg) * noise, (len(pairs), 3))
    if errors.mast_deg:
        own = rng.spawn(1)[0]  # all other values are drawn as without blunders
        B = mast_partials(pairs)
        pointings += B @ own.normal(0, np.radians(errors.mast_deg) * noise, B.shape[2])
    views = [_true_view(truth, pairs, pointings, k, pairs_per_stop) for k in range(len(pairs))]
    plan = _tie_plan(
        rng,
        truth,
        (cross_ties, far_cross_ties, inter_ties, intra_ties),
        laps if loop else 0,
        untied,
    )
    points, seen = _observe(views, plan, pairs_per_stop)
    left, parallax = _measure(pairs, views, points, seen)
    size = rng.normal(0, sigma_px * tie_noise * noise, (len(seen), 3))
    wrong = _blunders(rng, seen, pairs_per_stop, blunders)
    wrong_px = np.column_stack([wrong, 0.5 * wrong, 0.2 * wrong * np.minimum(1.0, parallax / 10.0)])
    size += wrong_px
    ties = TiePoints(
        tuple(pair.pair_id for pair in pairs),
        seen[:, 0].astype(np.int32),
        seen[:, 1].astype(np.int32),
        left + size[:, :2],
        np.maximum(parallax + size[:, 2], 0.5),
        np.full(len(seen), sigma_px),
        np.full(len(seen), sigma_px),
        np.full(len(seen), sigma_px),
    )
    priors = tuple(
        StopPrior(stop_name(k), pose, "FINE" if _is_fine(k, fine_every) else "COARSE", (k + 1,))
        for k, pose in enumerate(telemetry)
    )
    return Network(priors, pairs, ties), NetworkTruth(truth, pointings, points, wrong, wrong_px)


def _is_fine(k: int, fine_every: int) -> bool:
    return bool(fine_every) and k > 0 and k % fine_every == 0


def _height(xy: Float64[np.ndarray, "n 2"]) -> PerPoint:
    """Down coordinate of the ground: undulations of some tens of metres, up to 3 m high."""
    x, y = xy.T
    return 1.0 * np.sin(x / 17.0) * np.cos(y / 23.0) + 0.3 * np.sin(x / 4.1 + y / 5.3) - 0.02 * x


def _traverse(
    rng: np.random.Generator, names: list[StopId], spacing_m: float, laps: int
) -> tuple[Pose, ...]:
    """True poses; the first at the origin, level except for the ground's tilt. No laps: open."""
    stops = len(names)
    turn = np.full(stops, 2 * np.pi * laps / stops) if laps else rng.normal(0, 0.2, stops)
    heading = rng.uniform(-np.pi, np.pi) + np.cumsum(turn)
    steps = spacing_m * rng.uniform(0.8, 1.2, stops)[:, None]
    along = np.column_stack([np.cos(heading), np.sin(heading)]) * (spacing_m if laps else steps)
    xy = np.vstack([[0.0, 0.0], np.cumsum(along, axis=0)])[:stops]
    if laps > 1:
        xy += rng.normal(0, 1.0, xy.shape)  # all stops are at different positions
    down = _height(xy) - _height(xy[:1])
    tilts = rng.normal(0, np.radians(4.0), (stops, 2))
    return tuple(
        Pose(
            LSL,
            names[k].frame,
            rotation_of_roll_pitch_yaw(float(tilts[k, 0]), float(tilts[k, 1]), float(heading[k])),
            np.array([*xy[k], down[k]]),
        )
        for k in range(stops)
    )


def _telemetry(
    rng: np.random.Generator,
    truth: tuple[Pose, ...],
    errors: TelemetryErrors,
    noise: float,
    fine_every: int,
) -> list[Pose]:
    """Telemetry of the rover: each drive starts at the last reported pose, the first is exact."""
    poses, azimuth = [truth[0]], 0.0
    for k, (before, here) in enumerate(pairwise(truth), start=1):
        step = before.rotation.T @ (here.translation_m - before.translation_m)
        length = float(np.linalg.norm(step))
        # the standard deviation that an adjustment computes from the *reported* length
        sigma = noise * (errors.slip * length + errors.position_floor_m)
        slip = errors.drive_slips[k - 1] if errors.drive_slips else errors.mean_slip
        reported = step * (1 + slip * noise) + rng.normal(0, sigma, 3)
        azimuth += rng.normal(0, np.radians(errors.azimuth_step_deg) * noise)
        if _is_fine(k, fine_every):
            azimuth = rng.normal(0, np.radians(errors.azimuth_fine_deg) * noise)
        tilt = np.append(rng.normal(0, np.radians(errors.tilt_deg) * noise, 2), 0.0)
        turn = rotation_of_vector(np.array([0.0, 0.0, azimuth])) @ rotation_of_vector(tilt)
        place = poses[-1].translation_m + poses[-1].rotation @ reported
        poses.append(Pose(LSL, here.source, turn @ here.rotation, place))
    return poses


def _panorama(stop: StopId, names: list[str]) -> list[PairGeometry]:
    """Nominal pairs of a panorama: at equal angles, 18 degrees down."""
    pairs, rover = [], stop.frame
    for k, name in enumerate(names):
        azimuth, elevation = 2 * np.pi * k / len(names), np.radians(ELEVATION_DEG)
        forward = np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                -np.sin(elevation),
            ]
        )
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        rotation = np.column_stack([right, np.cross(forward, right), forward])
        origin = np.array([0.3, 0.0, -MAST_M]) - right * BASE_M / 2 + 0.05 * forward
        frame = Frame(FrameKind.PAIR, (*rover.index, k))
        pose, mast = Pose(rover, frame, rotation, origin), (0.3, 0.0, -MAST_M + 0.15)
        shape = EpipolarPair(pose, BASE_M, FOCAL_PX, (511.5, 511.5), LINES, LINES, mast)
        pairs.append(PairGeometry(name, stop, shape))
    return pairs


def _true_view(
    truth: tuple[Pose, ...], pairs: tuple[PairGeometry, ...], pointings: np.ndarray, k: int, n: int
) -> Pose:
    label, pivot = pairs[k].geometry.rover_from_pair, pairs[k].geometry.pivot_in_rover
    turn = rotation_of_vector(pointings[k])
    turned = Pose(
        label.target,
        label.source,
        turn @ label.rotation,
        pivot + turn @ (label.translation_m - pivot),
    )
    return (truth[k // n] @ turned).inverse


@dataclass(frozen=True, slots=True, eq=False)
class _PlannedTies:
    """Candidate points, and the required numbers of stops and pairs that see them."""

    candidates: ObjectPoints
    stops: tuple[int, ...]
    count: int
    pairs: int


def _tie_plan(
    rng: np.random.Generator,
    truth: tuple[Pose, ...],
    counts: tuple[int, int, int, int],
    laps: int,
    untied: AbstractSet[int],
) -> list[_PlannedTies]:
    cross, far, inter, intra = counts
    centres = np.array([pose.translation_m for pose in truth])
    plan = []
    n = len(truth)
    for k in range(n):
        revisit = ((n // laps, cross),) if laps > 1 and k + n // laps < n else ()
        for lag, count in ((1, cross), (2, far), *revisit):
            other = (k + lag) % n if laps else k + lag
            if not untied.isdisjoint(range(k + 1, other + 1)):
                continue
            if count and other < n and other != k:
                middle = (centres[k] + centres[other]) / 2
                spread = 0.35 * float(np.linalg.norm(centres[k] - centres[other])) + 2.0
                candidates = _ground(rng, middle[:2], spread, 12 * count)
                plan.append(_PlannedTies(candidates, (k, other), count, 1))
        radius = rng.uniform(3.0, 15.0, 60 * (inter + intra) + 1)
        angle = rng.uniform(0, 2 * np.pi, len(radius))
        near = centres[k, :2] + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        ground = np.column_stack([near, _lift(rng, near)])
        half = 50 * inter
        plan.append(_PlannedTies(ground[:half], (k,), inter, 2))
        plan.append(_PlannedTies(ground[half:], (k,), intra, 1))
    return plan


def _ground(
    rng: np.random.Generator, middle: np.ndarray, spread: float, count: int
) -> ObjectPoints:
    xy = middle + rng.normal(0, spread, (count, 2))
    return np.column_stack([xy, _lift(rng, xy)])


def _lift(rng: np.random.Generator, xy: np.ndarray) -> PerPoint:
    """Ground and rocks up to some decimetres on it, in heights relative to the first stop."""
    return _height(xy) - _height(np.zeros((1, 2))) - rng.exponential(0.1, len(xy))


def _observe(
    views: list[Pose], plan: list[_PlannedTies], per_stop: int
) -> tuple[ObjectPoints, np.ndarray]:
    """The chosen points, and rows (point, pair) of their observations."""
    chosen: list[ObjectPoints] = []
    seen: list[tuple[int, int]] = []
    number = 0
    for planned in plan:
        numbers = [s * per_stop + i for s in planned.stops for i in range(per_stop)]
        visible = np.array([_visible(views[k], planned.candidates) for k in numbers])
        each = visible.reshape(len(planned.stops), per_stop, -1).sum(axis=1)
        good = np.flatnonzero((each >= planned.pairs).all(axis=0))[: planned.count]
        for c in good.tolist():
            for row, k in enumerate(numbers):
                if visible[row, c] and (planned.pairs > 1 or len(planned.stops) > 1 or
                                        row == int(visible[:, c].argmax())):  # fmt: skip
                    seen.append((number, k))
            number += 1
        chosen.append(planned.candidates[good])
    points = np.vstack(chosen) if chosen else np.zeros((0, 3))
    return points, np.array(seen, dtype=np.int64).reshape(-1, 2)


def _visible(pair_from_lsl: Pose, points: ObjectPoints) -> np.ndarray:
    x, y, z = pair_from_lsl.apply(points).T
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v, p = 511.5 + FOCAL_PX * x / z, 511.5 + FOCAL_PX * y / z, FOCAL_PX * BASE_M / z
    inside = (u - p > 0) & (u < LINES - 1) & (v > 0) & (v < LINES - 1)
    return inside & (z > 1.0) & (z < RANGE_M)


def _measure(
    pairs: tuple[PairGeometry, ...], views: list[Pose], points: np.ndarray, seen: np.ndarray
) -> tuple[ImagePoints, PerPoint]:
    """Exact image coordinates and parallaxes of every observation."""
    left, parallax = np.zeros((len(seen), 2)), np.zeros(len(seen))
    for k in np.unique(seen[:, 1]).tolist():
        rows = np.flatnonzero(seen[:, 1] == k)
        left[rows], parallax[rows] = pairs[k].geometry.project(
            views[k].apply(points[seen[rows, 0]])
        )
    return left, parallax


def _blunders(
    rng: np.random.Generator, seen: np.ndarray, per_stop: int, fraction: float
) -> Float64[np.ndarray, " n"]:
    """Errors of 5 to 100 pixels in some observations of cross-site ties."""
    size = np.zeros(len(seen))
    if not fraction:
        return size
    stop = seen[:, 1] // per_stop
    low, high = np.full(seen[:, 0].max() + 1, 1 << 30), np.full(seen[:, 0].max() + 1, -1)
    np.minimum.at(low, seen[:, 0], stop)
    np.maximum.at(high, seen[:, 0], stop)
    cross = np.flatnonzero(high > low)
    points = rng.choice(cross, round(fraction * len(cross)), replace=False)
    for point in points.tolist():
        row = rng.choice(np.flatnonzero(seen[:, 0] == point))
        size[row] = rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(5.0), np.log(100.0)))
    return size
