"""Alignment of the ground of one stop with that of another, pair by pair, by its shape.

Where two stops have dense parallax of the same ground, a point Y of the one, carried into a pair of
the other, has there

    r = p(x, y) - f B / Z,       dr / dY = grad p . d(x, y)/dY + f B / Z^2 dZ/dY,

the parallax that was measured at its image less its own; grad p is that of the facet there, a plane
of parallax (`parallax_planes`). The rigid motion of the later stop's ground that makes r vanish is
found by least squares over the points of both, each compared with the other's ground: least-squares
matching of surfaces (Gruen and Akca 2005, ISPRS J. 59, 151-174), points against planes (Chen and
Medioni 1992), in pixels of parallax, whose noise is the same near and far.

A facet is seen under the angle whose sine is n . X / (|n| |X|). Rays that graze the ground meet
crests, and what the window makes of the step behind a crest is no ground at all; such facets are
left out, and so are points that only one of the stops can have seen: facets turned away, ranges
that do not compare.

What one side of a stone shows lies nearer to the camera than the stone, and windows at a grazing
ray add to what stands up. Along the rays and up, the shapes that two stops see are therefore some
centimetres apart, however many points agree: c and b below. Across the rays nothing prefers one
side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from solmap.photogrammetry.arrays import (
    Directions,
    Flags,
    Float32,
    Float64,
    ImagePoints,
    Int32,
    ObjectPoints,
    ParallaxMap,
    PerPoint,
    Rotation,
    Vector3,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, projection_partials
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.parallax_planes import EVERY, ParallaxPlanes, parallax_facets
from solmap.photogrammetry.ranges import (
    Count,
    FactorFromOne,
    Few,
    Metres,
    MetresOrZero,
    Pixels,
    PixelsOrZero,
    Radians,
    WholePixels,
)
from solmap.photogrammetry.robust import robust_sigma

MOTION = 6
"""Unknowns of a rigid motion: rotation vector, shift."""

Shifts = tuple[Float64[np.ndarray, "earlier 3"], Float64[np.ndarray, "later 3"]]
"""Of the later stop's ground, at the points of the earlier stop's ground and at its own, metres."""


RANGE_RATIO = 2.0
"""Ground that one stop sees from so many times as far as the other shows it other faces."""


LEAST_FACING = 0.05
"""Sine of the angle under which a facet must be seen by its own stop, 3 degrees: the ground at
20 to 30 m. Below it lie crests, and the steps behind them."""


LEAST_TURNED = 0.03
"""And by the other stop: what is turned away from that one it cannot have seen."""


@dataclass(frozen=True, slots=True)
class SurfaceParams:
    """How ground is held against ground."""

    step_px: WholePixels = 8
    """Every so many pixels a point is taken: neighbours share but the rim of their windows."""
    half_px: WholePixels = 5
    """Half the window of a facet."""
    farthest_m: Metres = 30.0
    least_points: Count = 60
    """Of the ground that two pairs share, both counted."""
    sigma_parallax_px: Pixels = 0.1
    """Of dense parallax."""
    correlated: FactorFromOne = 8.0
    """So many points say what one would: windows overlap, and so do the stones within them."""
    pointing_sigma: Radians = 0.0026
    """Radians an axis by which two pairs may be turned against each other before."""
    shift_sigma_m: MetresOrZero = 0.1
    """How far any ground may be from where it is said to be,"""
    bias_parallax_px: PixelsOrZero = 0.05
    """c: and how far what a stop sees lies from the middle of things, along its rays;"""
    bias_line_px: PixelsOrZero = 1.5
    """b: and above them. Standard deviations, as rendered and simulated ground has them."""
    rounds: Few = 12

    def __post_init__(self) -> None:
        if not (self.step_px > 0 and self.half_px > 0 and self.correlated >= 1 and self.rounds > 0):
            raise MatchingError(
                "ground is held against ground in steps, windows and rounds of at least one"
            )


@dataclass(frozen=True, eq=False)
class SurfaceView:
    """The facets of a pair, and where the pair stands in a common frame of two stops."""

    geometry: EpipolarPair
    rotation: Rotation
    """Of the pair in the common frame."""
    centre: Vector3
    """The left camera in the common frame, metres."""
    parallax: ParallaxMap
    half_px: int
    """Half the window of a facet."""

    @classmethod
    def of(
        cls, geometry: EpipolarPair, parallax: ParallaxMap, frame_from_pair: Pose, half_px: int
    ) -> SurfaceView:
        """A pair placed in the common frame."""
        return cls(
            geometry, frame_from_pair.rotation, frame_from_pair.translation_m, parallax, half_px
        )

    @cached_property
    def planes(self) -> Float32[np.ndarray, "4 rows cols"]:
        """Parallax, its gradient along sample and line, and residual, every `EVERY` pixels."""
        return parallax_facets(self.parallax, self.half_px)

    def at(self, points: ImagePoints) -> ParallaxPlanes:
        """The facets at image points; those outside the image have none."""
        _, rows, cols = self.planes.shape
        inside = self.geometry.shows(points)
        node = np.rint(np.where(inside[:, None], points, 0.0) / EVERY)
        node = np.minimum(node, (cols - 1, rows - 1))
        col, row = node.astype(np.int64).T
        parallax, along, down, residual = self.planes[:, row, col].astype(np.float64)
        parallax[~inside] = np.nan
        gradient = np.column_stack([along, down])
        return ParallaxPlanes(
            parallax + (gradient * (points - EVERY * node)).sum(axis=1), gradient, residual
        )

    def grid(self, step_px: int) -> ImagePoints:
        """Image points `step_px` apart where there is parallax."""
        line, sample = np.mgrid[
            step_px // 2 : self.geometry.lines : step_px,
            step_px // 2 : self.geometry.samples : step_px,
        ]
        known = self.parallax[line, sample] > 0
        return np.column_stack([sample[known], line[known]]).astype(np.float64)

    def place(self, points: ImagePoints, parallax_px: PerPoint) -> ObjectPoints:
        """Where image points lie in the common frame, metres."""
        in_pair = self.geometry.triangulate(points, parallax_px)
        return in_pair @ self.rotation.T + self.centre

    def by_place(self, in_pair: ObjectPoints) -> Float64[np.ndarray, "n 3 3"]:
        """Derivative of (sample, line, parallax) by places of the common frame, pixels per metre.

        `in_pair` are the places in the frame of the pair, metres.
        """
        g = self.geometry
        return projection_partials(in_pair, g.focal_px, g.base_m) @ self.rotation.T

    def normals(self, planes: ParallaxPlanes, points: ImagePoints) -> Directions:
        """Unit normals of facets in the common frame, away from the camera."""
        return unit_vectors(planes.normals(points, self.geometry)) @ self.rotation.T

    def facing(self, normals: Directions, places: ObjectPoints) -> PerPoint:
        """Sine of the angle under which facets are seen; below zero from behind."""
        return (normals * unit_vectors(places - self.centre)).sum(axis=1)


def unit_vectors(vectors: ObjectPoints) -> Directions:
    """Vectors of length one."""
    with np.errstate(invalid="ignore"):
        return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@dataclass(frozen=True, slots=True, eq=False)
class Misfits:
    """Points of one pair held against the ground of the other, n of them."""

    row: Int32[np.ndarray, " n"]
    """Of the point, among those of its pair."""
    misfit_px: PerPoint
    """r."""
    by_shift: ObjectPoints
    """Its derivative by a shift of the later stop's ground, pixels per metre."""
    variance: PerPoint
    """Square pixels, of both parallaxes and of what facets leave."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Points of the ground that a pair sees."""

    view: SurfaceView
    points: ImagePoints
    parallax_px: PerPoint
    places: ObjectPoints
    """In the common frame, metres."""
    normals: Directions
    """Of the facets there, in the common frame, away from the pair."""
    by_parallax: ObjectPoints
    """Derivative of the places by the parallax, metres per pixel."""

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def of(cls, view: SurfaceView, other: Vector3, params: SurfaceParams) -> Ground:
        """The points of a pair that a stop whose cameras stand at `other` may see as well."""
        points = view.grid(params.step_px)
        column, line = points.astype(np.int64).T
        parallax = view.parallax[line, column].astype(np.float64)
        places = view.place(points, parallax)
        near, far = (np.linalg.norm(places - at, axis=1) for at in (view.centre, other))
        reached = (np.maximum(near, far) < params.farthest_m) & _ranges_compare(near, far)
        points, parallax, places = points[reached], parallax[reached], places[reached]
        if not len(points):
            return cls(view, points, parallax, places, places, places)
        normals = view.normals(view.at(points), points)
        good = view.facing(normals, places) > LEAST_FACING
        good &= (normals * unit_vectors(places - other)).sum(axis=1) > LEAST_TURNED
        along = (view.centre - places) / parallax[:, None]
        return cls(view, *(c[good] for c in (points, parallax, places, normals, along)))

    def compare(self, target: SurfaceView, shift_m: ObjectPoints, params: SurfaceParams) -> Misfits:
        """The points, shifted, held against the ground of another pair.

        The derivative is by a shift of these points.
        """
        places = self.places + shift_m
        in_target = (places - target.centre) @ target.rotation
        points, parallax = target.geometry.project(in_target)
        margin = params.half_px
        row = np.flatnonzero(
            target.geometry.shows(points - margin) & target.geometry.shows(points + margin)
        )
        facets = target.at(points[row])
        places, in_target, points = places[row], in_target[row], points[row]
        normals = target.normals(facets, points)
        slope = np.column_stack([facets.gradient, -np.ones(len(row))])
        by_shift = (slope[:, None] @ target.by_place(in_target))[:, 0]
        own = (by_shift * self.by_parallax[row]).sum(axis=1)
        noise = params.sigma_parallax_px**2 * (1 + own**2) + (facets.residual_px / 2) ** 2
        good = target.facing(normals, places) > LEAST_FACING
        good &= self.view.facing(normals, places) > LEAST_TURNED
        misfit = facets.parallax_px - parallax[row]
        return Misfits(*(c[good] for c in (row.astype(np.int32), misfit, by_shift, noise)))


def _ranges_compare(near: PerPoint, far: PerPoint) -> Flags:
    """Whether ground is seen from ranges that compare."""
    return (near < RANGE_RATIO * far) & (far < RANGE_RATIO * near)


@dataclass(frozen=True, slots=True, eq=False)
class GroundPair:
    """A pair of the earlier stop and one of the later, and the ground that both see."""

    earlier: Ground
    later: Ground
    middle: Vector3
    """Of the ground, about which it turns."""

    @classmethod
    def of(cls, earlier: Ground, later: Ground, params: SurfaceParams) -> GroundPair | None:
        """None where they see next to nothing in common."""
        if not (len(earlier) and len(later)):
            return None
        couple = cls(earlier, later, np.zeros(3))
        seen = couple.misfits(couple.no_shift, params)
        if sum(len(m.row) for m in seen) < params.least_points:
            return None
        return replace(couple, middle=couple.places_of(seen).mean(axis=0))

    @property
    def grounds(self) -> tuple[Ground, Ground]:
        """That of the earlier stop first."""
        return self.earlier, self.later

    @property
    def across(self) -> Vector3:
        """Level direction across the rays of both to the middle of their ground."""
        one, other = (
            unit_vectors(self.middle[None] - ground.view.centre)[0] for ground in self.grounds
        )
        along = one - other if one @ other < 0 else one + other
        return np.array([-along[1], along[0], 0.0]) / np.hypot(along[0], along[1])

    @property
    def no_shift(self) -> Shifts:
        """No shift for any point of either."""
        return np.zeros((len(self.earlier), 3)), np.zeros((len(self.later), 3))

    def misfits(self, shifts: Shifts, params: SurfaceParams) -> tuple[Misfits, Misfits]:
        """Both grounds, each held against the other, the later one's shifted."""
        of_earlier, of_later = shifts
        back = self.earlier.compare(self.later.view, -of_earlier, params)
        return (
            replace(back, by_shift=-back.by_shift),
            self.later.compare(self.earlier.view, of_later, params),
        )

    def places_of(self, seen: Sequence[Misfits]) -> ObjectPoints:
        """Where the points lie that were held against each other."""
        return np.concatenate([g.places[m.row] for g, m in zip(self.grounds, seen, strict=True)])

    def shifts_by(self, motion: Float64[np.ndarray, " 6"]) -> Shifts:
        """The shifts of all points under a small rigid motion of the later stop's ground."""
        earlier, later = (
            np.cross(motion[:3], ground.places - self.middle) + motion[3:]
            for ground in self.grounds
        )
        return earlier, later

    def shape_bias(
        self, places: ObjectPoints, params: SurfaceParams
    ) -> Float64[np.ndarray, "n 3 3"]:
        """Covariance of how far apart the shapes are that both see at places, square metres."""
        spread = np.zeros((len(places), 3, 3))
        for view in (ground.view for ground in self.grounds):
            ray = places - view.centre
            depth = ray @ view.rotation[:, 2]
            per_px = depth / (view.geometry.focal_px * view.geometry.base_m)
            along = params.bias_parallax_px * per_px[:, None] * ray
            spread += along[:, :, None] * along[:, None, :]
            spread[:, 2, 2] += (params.bias_line_px * depth / view.geometry.focal_px) ** 2
        return spread

    def prior(self, places: ObjectPoints, params: SurfaceParams) -> Float64[np.ndarray, "n 3 3"]:
        """Weights of a shift of the later stop's ground beforehand, per square metre."""
        return np.linalg.inv(self.shape_bias(places, params) + params.shift_sigma_m**2 * np.eye(3))

    def align(self, params: SurfaceParams) -> Float64[np.ndarray, " 6"]:
        """The motion of the later stop's ground that lays it onto the earlier one's.

        Rotation vector about `middle` (radians), then shift (metres), in the common frame.
        """
        prior = np.zeros((MOTION, MOTION))
        prior[:3, :3] = np.eye(3) / params.pointing_sigma**2
        prior[3:, 3:] = self.prior(self.middle[None], params)[0]
        motion = np.zeros(MOTION)
        for _ in range(params.rounds):
            seen = self.misfits(self.shifts_by(motion), params)
            misfit, by_shift, weight = robust_weights(seen, params)
            arm = self.places_of(seen) - self.middle
            design = np.hstack([np.cross(arm, by_shift), by_shift])
            weighted = (design * weight[:, None]).T
            step = np.linalg.solve(weighted @ design + prior, -(weighted @ misfit) - prior @ motion)
            motion = motion + step
        return motion


def robust_weights(
    seen: Sequence[Misfits], params: SurfaceParams
) -> tuple[PerPoint, ObjectPoints, PerPoint]:
    """(misfits, derivatives, weights) of both grounds; what is far off counts next to nothing."""
    misfit, by_shift, variance = (
        np.concatenate([getattr(m, name) for m in seen])
        for name in ("misfit_px", "by_shift", "variance")
    )
    spread = max(robust_sigma(misfit / np.sqrt(variance)), 1.0) ** 2
    variance = variance * spread * params.correlated
    return (
        misfit,
        by_shift,
        1.0 / (variance * (1 + params.correlated * misfit**2 / (4 * variance)) ** 2),
    )
