"""The geometry of two single images of one stop, with cameras centimetres apart.

A mast camera is off the axis about which the mast turns, so two images of a panorama have a
baseline b of 6 to 9 cm (25 cm at most): little, but the ground is near. With the direction d = (x,
y, 1) of a point in the first image and its inverse depth q, it is seen in the second at

    y = R d + q t,        x' = c + f (y_1, y_2) / y_3,        q from 0 (infinity) to 1/nearest

by the labels' (R, t). The segment of all x' is the epipolar line; only pointing errors, 0.15
degrees per axis and image, displace a point from it. A small rotation w of the second camera
changes y to Exp(w)' y; it is estimated from the distances across the epipolar lines,

    e(w) = l . x' / |(l_1, l_2)|,        l = K'^-T [Exp(w)' t]_x Exp(w)' R d

with a loss that changes from nearly linear to redescending (graduated, as in `alignment`). Blunders
are points off their line by more than three robust standard deviations, nearer than the nearest
range or behind infinity by more than pointing errors explain, or off the terrain by their
neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import Flags, Float64, ImagePoints, PerPoint, Vector3
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.stereo.verification import (
    VerificationParams,
    agrees_with_terrain,
)
from solmap.photogrammetry.robust import robust_sigma

SCALES_PX = (8.0, 3.0, 1.0, 0.4)
"""Scales of the loss, one after the other: from twice a usual pointing error to matching."""
LEAST_SPREAD_PX = 0.1
"""Lower limit of the standard deviation of least-squares matching."""
LIMIT_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class TwoViews:
    """A second image's view of points of a first one, by the labels."""

    one: EpipolarPair
    other: EpipolarPair

    @property
    def other_from_one(self) -> Pose:
        """Relative pose by the labels' mast kinematics."""
        return self.other.rover_from_pair.inverse @ self.one.rover_from_pair

    def project(
        self, points: ImagePoints, inverse_depth: PerPoint, turn: Vector3 | None = None
    ) -> ImagePoints:
        """Positions in the second image of points at some inverse depth; NaN behind it."""
        pose = self.other_from_one
        y = self.one.rays(points) @ pose.rotation.T
        y = y + inverse_depth[:, None] * pose.translation_m
        if turn is not None:
            y = y @ rotation_matrix(turn)
        z = np.where(y[:, 2:] > 0, y[:, 2:], np.nan)
        return np.array(self.other.centre_px) + self.other.focal_px * y[:, :2] / z

    def epipolar_distance(self, points: ImagePoints, seen: ImagePoints, turn: Vector3) -> PerPoint:
        """Signed distance of points of the second image from their epipolar lines, pixels."""
        pose, back = self.other_from_one, rotation_matrix(turn).T
        far = self.one.rays(points) @ pose.rotation.T @ back.T
        line = np.cross(back @ pose.translation_m, far)
        measured = self.other.rays(seen)
        norm = np.maximum(np.linalg.norm(line[:, :2], axis=1), 1e-12)
        return self.other.focal_px * (line * measured).sum(axis=1) / norm

    def epipolar_parallax(self, points: ImagePoints, seen: ImagePoints, turn: Vector3) -> PerPoint:
        """Distance of a point along its epipolar line from its position at infinity, pixels.

        Positive towards the near end.
        """
        nothing = np.zeros(len(points))
        far = self.project(points, nothing, turn)
        near = self.project(points, nothing + 1e-3 / self.base_m, turn) - far
        direction = near / np.maximum(np.linalg.norm(near, axis=1, keepdims=True), 1e-12)
        return ((seen - far) * direction).sum(axis=1)

    @property
    def base_m(self) -> float:
        """Between the two cameras."""
        return float(np.linalg.norm(self.other_from_one.translation_m))


def rotation_matrix(turn: Vector3) -> Float64[np.ndarray, "3 3"]:
    """Exp(w); rows of vectors times it are rotated by Exp(w)'."""
    return ScipyRotation.from_rotvec(turn).as_matrix()


def relative_turn(
    two_views: TwoViews, points: ImagePoints, seen: ImagePoints, pointing_sigma: float
) -> Vector3:
    """Rotation of the second camera from its label, relative to the first; radians."""
    turn = np.zeros(3)
    sigma = np.sqrt(2.0) * pointing_sigma
    for scale in SCALES_PX:

        def residuals(w: np.ndarray, scale: float = scale) -> np.ndarray:
            return np.concatenate([two_views.epipolar_distance(points, seen, w) / scale, w / sigma])

        turn = least_squares(residuals, turn, loss="cauchy", x_scale=pointing_sigma).x
    return turn


@dataclass(frozen=True, slots=True, eq=False)
class TwoViewCheck:
    """Which conjugates agree with the geometry of the two images."""

    agrees: Flags
    turn: Vector3
    """Rotation vector of the second camera relative to the first, in its own frame, radians."""
    across_px: PerPoint
    """Distance from the epipolar line of the labels."""
    left_px: PerPoint
    """Image points after the rotation."""
    along_px: PerPoint
    """Distance from infinity along that line, after the rotation."""
    misfit: PerPoint
    """Distance from the line after the rotation, as a fraction of its limit."""


def check_conjugates(
    two_views: TwoViews,
    points: ImagePoints,
    seen: ImagePoints,
    nearest_m: float,
    pointing_sigma: float,
    terrain: VerificationParams,
) -> TwoViewCheck:
    """Check conjugates against the epipolar geometry, the range and their neighbours."""
    turn = relative_turn(two_views, points, seen, pointing_sigma)
    left = two_views.epipolar_distance(points, seen, turn)
    spread = max(robust_sigma(left), LEAST_SPREAD_PX)
    misfit = np.abs(left) / (LIMIT_SIGMAS * spread)
    agrees = misfit <= 1.0
    along = two_views.epipolar_parallax(points, seen, turn)
    slack = LIMIT_SIGMAS * np.sqrt(2.0) * pointing_sigma * two_views.other.focal_px
    nearest = two_views.project(points, np.full(len(points), 1.0 / nearest_m), turn)
    furthest = two_views.epipolar_parallax(points, nearest, turn)
    agrees &= (along >= -slack) & ~(along > furthest + slack)
    agrees[agrees] = agrees_with_terrain(points[agrees], along[agrees], terrain)
    return TwoViewCheck(
        agrees, turn, two_views.epipolar_distance(points, seen, np.zeros(3)), left, along, misfit
    )
