"""Georeference an uncontrolled orbital mosaic to traverse points: rotation, scale, residuals.

Di et al. 2008 (section 4) identified nine stops on the rover track of an uncontrolled MOC mosaic,
found it rotated by 1.3 degrees against the adjusted traverse, georeferenced it with these points as
control, moved it so that both begin at the lander, and reported the remaining differences: 8.8 m on
average, 12 m or 0.4 % of the distance at the last point. This does the same with the errors of the
parameters.

A similarity rotates and scales; an affinity may also stretch in one direction and shear, as in
mosaics of several strips. Both are fitted by least squares about the centroid, so that shift and
rotation are independent.

Simulated points have an exactly known solution: their displacements are made orthogonal to every
similarity of the mosaic's track, so that georeferencing must return exactly the given rotation and
scale, and the displacements as residuals.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from solmap.photogrammetry.arrays import Float64, PerPoint
from solmap.photogrammetry.errors import TraverseError
from solmap.photogrammetry.traverse.records import leg_lengths

COLUMNS = ("name", "mosaic_x_m", "mosaic_y_m", "east_m", "north_m")


class MapTransform(StrEnum):
    """Kind of transform between two maps."""

    SIMILARITY = "similarity"
    """Shift, rotation, one scale: four parameters."""
    AFFINITY = "affinity"
    """Six parameters."""


FEWEST = {MapTransform.SIMILARITY: 2, MapTransform.AFFINITY: 3}


@dataclass(frozen=True, slots=True, eq=False)
class Georeference:
    """The transform of a map from its points to control points."""

    transform: MapTransform
    matrix: Float64[np.ndarray, "2 2"]
    shift_m: Float64[np.ndarray, " 2"]
    residuals_m: Float64[np.ndarray, "points 2"]
    """Transformed minus control, (east, north)."""
    sigma_m: float
    """Standard deviation of a coordinate, from the residuals; NaN without redundancy."""
    rotation_deg: float
    """Counter-clockwise rotation of the map onto the control."""
    sigma_rotation_deg: float
    scale: float
    sigma_scale: float

    def apply(self, points_m: Float64[np.ndarray, "points 2"]) -> Float64[np.ndarray, "points 2"]:
        """Points of the map transformed to the control."""
        return points_m @ self.matrix.T + self.shift_m


@dataclass(frozen=True, slots=True, eq=False)
class TrackComparison:
    """Two tracks through the same stops, after georeferencing and with the same start."""

    differences_m: PerPoint
    """Differences in plan, at every point."""
    mean_m: float
    end_m: float
    end_percent: float
    """Percent of the distance travelled along the control track."""


def georeference(
    points_m: Float64[np.ndarray, "points 2"],
    control_m: Float64[np.ndarray, "points 2"],
    transform: MapTransform = MapTransform.SIMILARITY,
) -> Georeference:
    """Fit the transform from a map's points, (east, north), to the same points of the control.

    Raises:
        TraverseError: too few points, or coincident points (or points on a line, for an affinity).
    """
    if len(points_m) != len(control_m) or len(points_m) < FEWEST[transform]:
        raise TraverseError(
            f"{len(points_m)} points and {len(control_m)} controls: a {transform} needs at least "
            f"{FEWEST[transform]} of each, pairwise"
        )
    middle, goal = points_m.mean(axis=0), control_m.mean(axis=0)
    design = _design(points_m - middle, transform)
    found, _, rank, _ = np.linalg.lstsq(design, (control_m - goal).ravel(), rcond=1e-9)
    if rank < design.shape[1]:
        raise TraverseError(
            f"the {len(points_m)} points coincide or lie on one line: they do not determine a "
            f"{transform}; add points off the line"
        )
    matrix = _matrix(found, transform)
    residuals = (points_m - middle) @ matrix.T - (control_m - goal)
    redundancy = residuals.size - len(found) - 2
    sigma = math.sqrt(float((residuals**2).sum()) / redundancy) if redundancy > 0 else math.nan
    scale = math.sqrt(abs(float(np.linalg.det(matrix))))
    spread = math.sqrt(float(((points_m - middle) ** 2).sum()))
    return Georeference(
        transform=transform,
        matrix=matrix,
        shift_m=goal - matrix @ middle,
        residuals_m=residuals,
        sigma_m=sigma,
        rotation_deg=math.degrees(
            math.atan2(matrix[1, 0] - matrix[0, 1], matrix[0, 0] + matrix[1, 1])
        ),
        sigma_rotation_deg=math.degrees(sigma / (scale * spread)),
        scale=scale,
        sigma_scale=sigma / spread,
    )


def compare_tracks(
    track_m: Float64[np.ndarray, "points 2"], control_m: Float64[np.ndarray, "points 2"]
) -> TrackComparison:
    """Differences of two tracks through the same stops, with a common start at the first."""
    started = track_m - track_m[0] + control_m[0]
    apart = np.hypot(*(started - control_m).T)
    travelled = float(leg_lengths(control_m).sum())
    return TrackComparison(
        differences_m=apart,
        mean_m=float(apart[1:].mean()),
        end_m=float(apart[-1]),
        end_percent=100 * float(apart[-1]) / travelled if travelled > 0 else math.nan,
    )


def _design(
    p: Float64[np.ndarray, "points 2"], transform: MapTransform
) -> Float64[np.ndarray, "rows parameters"]:
    """Rows east, north, east, north, ... of the centred points."""
    x, y, o = p[:, 0], p[:, 1], np.zeros(len(p))
    columns = {
        MapTransform.SIMILARITY: ((x, -y), (y, x)),  # (a, b): [[a, -b], [b, a]]
        MapTransform.AFFINITY: ((x, y, o, o), (o, o, x, y)),
    }[transform]
    return np.stack([np.column_stack(rows) for rows in columns], axis=1).reshape(2 * len(p), -1)


def _matrix(found: np.ndarray, transform: MapTransform) -> Float64[np.ndarray, "2 2"]:
    if transform is MapTransform.AFFINITY:
        return found.reshape(2, 2)
    a, b = found
    return np.array([[a, -b], [b, a]])


@dataclass(frozen=True, slots=True, eq=False)
class MosaicPoints:
    """Corresponding points in a mosaic and on the map, in the order of the track."""

    names: tuple[str, ...]
    mosaic_m: Float64[np.ndarray, "points 2"]
    map_m: Float64[np.ndarray, "points 2"]
    """(east, north)."""

    def table(self) -> str:
        """CSV, rounded to a tenth of a millimetre."""
        rows = np.hstack([self.mosaic_m, self.map_m])
        lines = [
            ",".join([name, *(f"{value:.4f}" for value in row)])
            for name, row in zip(self.names, rows.tolist(), strict=True)
        ]
        return "\n".join([",".join(COLUMNS), *lines]) + "\n"


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedMosaic:
    """Points in a simulated mosaic, and the solution that georeferencing must return."""

    points: MosaicPoints
    rotation_deg: float
    """Counter-clockwise rotation of the mosaic onto the map."""
    scale: float
    residuals_m: Float64[np.ndarray, "points 2"]
    """Georeferenced mosaic minus map, (east, north)."""

    @property
    def differences_m(self) -> Float64[np.ndarray, " points"]:
        """Differences of both tracks, with a common start."""
        return np.hypot(*(self.residuals_m - self.residuals_m[0]).T)

    @property
    def end_percent(self) -> float:
        """The last difference, percent of the way along the map's track."""
        way = np.hypot(*np.diff(self.points.map_m, axis=0).T).sum()
        return 100 * float(self.differences_m[-1] / way)


def parse_points(text: str, source: str) -> MosaicPoints:
    """Read a table of points.

    Raises:
        TraverseError: the message names the file, the line and the fault.
    """
    rows = list(csv.reader(io.StringIO(text.removeprefix("\ufeff"))))
    names = [name.strip().lower() for name in rows[0]] if rows else []
    lost = [name for name in COLUMNS if name not in names]
    if lost:
        raise TraverseError(f"{source}: the first line lacks {lost[0]}; it must name {COLUMNS}")
    at = [names.index(name) for name in COLUMNS]
    found, labels = [], []
    for number, row in enumerate(rows[1:], 2):
        if not any(value.strip() for value in row):
            continue
        try:
            values = [float(row[k]) for k in at[1:]]
        except (ValueError, IndexError) as error:
            raise TraverseError(
                f"{source}, line {number}: four numbers are expected: {error}"
            ) from error
        if not all(map(math.isfinite, values)):
            raise TraverseError(f"{source}, line {number}: coordinates must be finite")
        labels.append(row[at[0]].strip())
        found.append(values)
    table = np.array(found, dtype=np.float64).reshape(-1, 4)
    return MosaicPoints(tuple(labels), table[:, :2], table[:, 2:])


def simulate_mosaic(
    rng: np.random.Generator,
    *,
    points: int = 9,
    length_m: float = 3000.0,
    rotation_deg: float = 1.3,
    scale: float = 1.002,
    displaced_m: float = 8.0,
) -> SimulatedMosaic:
    """A track in a mosaic that is rotated, scaled, shifted, and has displaced points.

    Args:
        rng: source of all randomness.
        points: number of points on the track.
        length_m: of the track.
        rotation_deg: rotation of the mosaic onto the map.
        scale: scale of the mosaic onto the map.
        displaced_m: root mean square of the residuals.
    """
    heading = np.cumsum(rng.normal(0.0, 0.4, points - 1)) + rng.uniform(-np.pi, np.pi)
    steps = length_m / (points - 1) * np.column_stack([np.sin(heading), np.cos(heading)])
    track = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
    drawn = rng.normal(size=2 * points)
    middle, units = track - track.mean(axis=0), np.tile(np.eye(2), (points, 1))
    across = np.column_stack([-middle[:, 1], middle[:, 0]])
    taken = np.column_stack([middle.ravel(), across.ravel(), units])
    Q, _ = np.linalg.qr(taken)
    left = (drawn - Q @ (Q.T @ drawn)).reshape(points, 2)
    left = left * (displaced_m / np.sqrt((left**2).sum(axis=1).mean()))
    c, s = np.cos(np.radians(rotation_deg)), np.sin(np.radians(rotation_deg))
    turn = scale * np.array([[c, -s], [s, c]])
    mosaic = (track - rng.uniform(-500, 500, 2)) @ np.linalg.inv(turn).T
    names = tuple(f"P{k + 1}" for k in range(points))
    return SimulatedMosaic(MosaicPoints(names, mosaic, track - left), rotation_deg, scale, left)
