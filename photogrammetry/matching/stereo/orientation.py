"""Errors of the relative orientation of two cameras, from the residual parallaxes of matching.

**Of a stereo rig** (`vertical_parallax`, `rig_rotation`). Rows of an epipolar pair correspond
exactly if the rig agrees with its camera models. A bent rig, or models of another exposure, cause a
vertical parallax v = y_r - y_l. A small rotation w of the right camera about the (right, down,
forward) axes rotates directions d = (x, y, 1) in its frame by -w x d, and so moves its image points
down by

    v = f [ w_x (1 + y^2) - w_y x y - w_z x ]

with x, y in units of f from the common axis. The rotation w of the right camera from its model is
estimated by least squares with blunders down-weighted. Offsets of windows are biased towards whole
pixels: where v was half a pixel, w_z was found 5 % too large and toe-in w_y 0.004 degrees off, 0.1
px of parallax. So rows are measured again with the right camera turned by w (`rows_of_rig`), where
v is nearly zero.

**Of cameras at two stops** (`relative_orientation`). Unknown are a rotation w of the right camera
and a shift B t of its centre across the baseline, about the (right, down, forward) axes of the
pair. With x, y the point in the right image in units of f, and p its parallax, they move it across
and along the epipolar line, so that one finds

    v = f [w_x (1 + y^2) - w_y x y - w_z x] + p (y t_z - t_y)
    p - q = f [w_y (1 + x^2) - w_z y - w_x x y] - p x t_z + s

where v is the vertical parallax and q the parallax predicted from a rig's own dense parallax
(`wide_baseline`), up to an error s common to all its predictions. Adjustment gives w and t
approximately: its standard deviations enter as observations, so unknowns that the images do not
determine stay unchanged. Blunders are down-weighted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import Float64, ImagePoints, PerPoint, Vector3
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Frame, Pose
from solmap.photogrammetry.matching.least_squares import match_offsets
from solmap.photogrammetry.matching.records import EpipolarImages, SharedSigma
from solmap.photogrammetry.matching.stereo.interest_points import (
    InterestPoints,
    strongest_by_cell,
)
from solmap.photogrammetry.matching.stereo.sparse import SparseParams, match_interest_points
from solmap.photogrammetry.ranges import Metres, Pixels, Radians
from solmap.photogrammetry.robust import geman_mcclure_weights, robust_sigma

LINE_TOLERANCE_PX = 6
"""Rows searched to either side: 0.3 degrees of a Navcam, twice the errors of real rigs."""

MOST_POINTS = 800
"""Points measured in both directions; enough for a median accurate to a hundredth of a pixel."""

FEWEST_POINTS = 12
"""Four times the three unknowns."""

WRONG_RIG_PX = 0.5
"""Vertical parallax above which the camera models do not fit the images: windows of 15 pixels
matched half a row off lose about a tenth of their correlation."""

ROW_CELLS = 4
"""Cells along each side of an image: residuals of the one available real pair, 0.2 px, are alike
over a quarter of it."""

STEPS = 10
"""Reweightings."""

FINEST_PX = 0.02
"""Lower limit of the spread of residuals."""

STRAIGHT_PX = 0.02
"""Vertical parallax by a rotation that need not be measured again."""


@dataclass(frozen=True, slots=True, eq=False)
class VerticalParallax:
    """Vertical parallax of a pair, right row minus left row, in pixels."""

    left: ImagePoints
    vertical_px: PerPoint
    parallax_px: PerPoint
    geometry: EpipolarPair

    @property
    def median_px(self) -> float:
        """Its median; NaN where nothing was measured."""
        return float(np.median(self.vertical_px)) if len(self.vertical_px) else np.nan

    @property
    def mad_px(self) -> float:
        """Its median absolute deviation from the median."""
        return (
            float(np.median(np.abs(self.vertical_px - self.median_px)))
            if len(self.vertical_px)
            else np.nan
        )

    @property
    def fits_the_rig(self) -> bool:
        """Whether the rows correspond as the camera models predict."""
        enough = len(self.vertical_px) >= FEWEST_POINTS
        return bool(enough and max(abs(self.median_px), self.mad_px) <= WRONG_RIG_PX)

    def __str__(self) -> str:
        result = "rows correspond"
        if len(self.vertical_px) < FEWEST_POINTS:
            result = "too few to check the camera models"
        elif not self.fits_the_rig:
            result = (
                "the camera models do not fit the images: another exposure, or a bent stereo rig"
            )
        return (
            f"vertical parallax {self.median_px:+.2f} px (MAD {self.mad_px:.2f}) at "
            f"{len(self.vertical_px)} points: {result}"
        )


FEWEST_OFFSETS = 30
"""Five times the six unknowns."""


@dataclass(frozen=True, slots=True)
class OrientationParams:
    """Assumed accuracy of adjusted orientations."""

    rotation_sigma: Radians = float(np.deg2rad(0.2))
    """Standard deviation of a relative rotation, radians: twice a mast's pointing error."""
    position_sigma_m: Metres = 0.05
    """Standard deviation of a relative position: adjusted neighbours are accurate to
    centimetres."""
    rig_sigma_px: Pixels = 0.03
    """Standard deviation common to all parallaxes of a rig: the accuracy of its rows after
    calibration, which its parallax cannot exceed."""


@dataclass(frozen=True, slots=True, eq=False)
class RelativeOrientation:
    """Correction of the right camera against its model, with the covariance."""

    rotation: Vector3
    """Rotation vector about (right, down, forward), radians."""
    shift: Vector3
    """Shift of the centre along (right, down, forward), in units of the baseline; the first is
    0."""
    covariance: Float64[np.ndarray, "6 6"]
    """Covariance of w_x, w_y, w_z, t_y, t_z and s in pixels."""

    unknowns: Float64[np.ndarray, " 6"]
    """Sum of all corrections added to the adjusted orientation, including this one; s is never
    added."""

    def apply(self, right: CameraModel, geometry: EpipolarPair) -> CameraModel:
        """The right camera with its corrected pose, in the frame of `geometry`."""
        pose = geometry.rover_from_pair
        turned = turn_in_place(right, pose.target, pose.rotation @ self.rotation)
        moved = pose.rotation @ self.shift * geometry.base_m
        return turned.transform(Pose(pose.target, pose.target, np.eye(3), moved))

    def shared_sigma(self, geometry: EpipolarPair, params: OrientationParams) -> SharedSigma:
        """Standard deviation common to all parallaxes: of w_y, and of the baseline's length."""
        turn_px = geometry.focal_px * float(np.sqrt(self.covariance[1, 1]))
        return SharedSigma(turn_px, params.position_sigma_m / geometry.base_m)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredOffsets:
    """Points found in both images of a pair."""

    rows: VerticalParallax
    predicted_px: PerPoint | None = None
    """Parallax predicted from the rig; None if not available."""
    rig_ratio: float = 1.0
    """Parallax of the pair over that of the rig."""


def vertical_parallax(
    images: EpipolarImages,
    params: SparseParams | None = None,
    points: tuple[InterestPoints, InterestPoints] | None = None,
) -> VerticalParallax:
    """Vertical parallax at well-distributed interest points, to a fraction of a pixel."""
    wide = replace(params or SparseParams(), line_tolerance_px=LINE_TOLERANCE_PX)
    candidates = match_interest_points(images, wide, points)
    left = candidates.left[candidates.accepted]
    right = candidates.right[candidates.accepted]
    kept = strongest_by_cell(
        left.astype(float), candidates.correlation[candidates.accepted], 48, MOST_POINTS
    )
    left, right = left[kept], right[kept]
    offset = match_offsets(images, left, (right - left).astype(np.float64), wide.window_px)
    good = np.isfinite(offset).all(axis=1)
    return VerticalParallax(
        left[good].astype(np.float64), offset[good, 1], -offset[good, 0], images.geometry
    )


def rows_of_rig(
    images: EpipolarImages,
    turned: Callable[[Vector3], EpipolarImages],
    points: tuple[InterestPoints, InterestPoints] | None = None,
) -> VerticalParallax:
    """Vertical parallax of a stereo rig against its models, without the bias towards whole pixels.

    Args:
        images: Of the models.
        turned: The same with the right camera rotated (right, down, forward axes; radians).
        points: Interest points of both images, if they were found before.
    """
    measured = vertical_parallax(images, points=points)
    if len(measured.left) < FEWEST_POINTS or not straightened(measured).fits_the_rig:
        return measured
    rotation = rig_rotation(measured)
    if (np.abs(_design(measured) @ rotation) < STRAIGHT_PX).all():
        return measured
    again = vertical_parallax(turned(rotation))
    if len(again.left) < FEWEST_POINTS:
        return measured
    return replace(again, vertical_px=again.vertical_px + _design(again) @ rotation)


def rig_rotation(measured: VerticalParallax) -> Vector3:
    """Rotation vector (right, down, forward axes; radians) of the right camera from its model."""
    if len(measured.left) < FEWEST_POINTS:
        raise MatchingError(
            f"{len(measured.left)} points with vertical parallax are too few to estimate a "
            f"rotation of the stereo rig; {FEWEST_POINTS} are needed"
        )
    design = _design(measured)
    weight = np.ones(len(design))
    rotation = np.zeros(3)
    for _ in range(STEPS):
        normal = (design * weight[:, None]).T @ design
        rotation = np.linalg.solve(normal, design.T @ (weight * measured.vertical_px))
        residual = measured.vertical_px - design @ rotation
        scale = max(robust_sigma(residual), 1e-3)
        weight = geman_mcclure_weights(residual, scale)
    return rotation


def straightened(measured: VerticalParallax) -> VerticalParallax:
    """The remaining vertical parallax after the best rotation of the right camera."""
    left = measured.vertical_px - _design(measured) @ rig_rotation(measured)
    return replace(measured, vertical_px=left)


@dataclass(frozen=True, slots=True, eq=False)
class RowCells:
    """Vertical parallax of pairs of one camera set, averaged over the cells of the image.

    Errors of lens models are smooth, so points of a cell share them: the accuracy of a rotation
    follows from residuals of cells, not of points.
    """

    weight: Float64[np.ndarray, " n"]
    """Inverse variances, 1/px^2; 0 where a cell has no point."""
    design: Float64[np.ndarray, "n 3"]
    """Derivatives by the rotation of the right camera, pixels."""
    vertical_px: PerPoint

    @classmethod
    def of(cls, measured: VerticalParallax) -> RowCells:
        """Of one pair; blunders are down-weighted under the best rotation."""
        design, shape = _design(measured), measured.geometry
        residual = straightened(measured).vertical_px
        scale = max(float(robust_sigma(residual)), FINEST_PX)
        weight = geman_mcclure_weights(residual, scale) / scale**2
        place = measured.left * [ROW_CELLS / shape.samples, ROW_CELLS / shape.lines]
        column, row = np.clip(place.astype(int), 0, ROW_CELLS - 1).T
        table = np.column_stack([design, measured.vertical_px])
        return cls._of_sums(*_sums(row * ROW_CELLS + column, weight, table))

    @classmethod
    def together(cls, cells: Sequence[RowCells]) -> RowCells:
        """The correction of several pairs together."""
        tables = (np.column_stack([one.design, one.vertical_px]) for one in cells)
        weighted = (one.weight[:, None] * table for one, table in zip(cells, tables, strict=True))
        return cls._of_sums(np.sum([one.weight for one in cells], axis=0), sum(weighted))

    @classmethod
    def _of_sums(cls, weight: np.ndarray, sums: np.ndarray) -> RowCells:
        mean = sums / np.where(weight > 0, weight, 1.0)[:, None]
        return cls(weight, mean[:, :3], mean[:, 3])

    def normal_equations(self) -> tuple[Float64[np.ndarray, "3 3"], Vector3]:
        """Matrix and right-hand side of the rotation, as if cells had the noise of points only."""
        weighted = self.design * self.weight[:, None]
        return weighted.T @ self.design, weighted.T @ self.vertical_px

    @property
    def variance_factor(self) -> float:
        """Scatter of the cells relative to noise, as a variance factor; at least 1."""
        rotation = np.linalg.lstsq(*self.normal_equations(), rcond=None)[0]
        residual = self.vertical_px - self.design @ rotation
        redundancy = np.count_nonzero(self.weight) - len(rotation)
        return max(1.0, float(self.weight @ residual**2) / max(int(redundancy), 1))

    def median_px(self, rotation: Vector3) -> float:
        """Median of the vertical parallax after a rotation."""
        seen = self.weight > 0
        return float(np.median((self.vertical_px - self.design @ rotation)[seen]))

    def rotation_with(self, toe_in: float) -> Vector3:
        """The best rotation with this toe-in, which rows hardly determine, radians."""
        free, weight = self.design[:, ::2], np.sqrt(self.weight)
        left = self.vertical_px - self.design[:, 1] * toe_in
        (x, z), *_ = np.linalg.lstsq(free * weight[:, None], left * weight, rcond=None)
        return np.array([x, toe_in, z])


def _sums(cell: np.ndarray, weight: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums of the weights, and of the weighted rows of a table, by cell."""
    size = ROW_CELLS**2
    columns = [np.bincount(cell, weight * column, size) for column in table.T]
    return np.bincount(cell, weight, size), np.column_stack(columns)


def turn_in_place(camera: CameraModel, frame: Frame, rotation: Vector3) -> CameraModel:
    """A camera rotated about its own centre by a rotation vector, both in the same frame."""
    turn = ScipyRotation.from_rotvec(rotation).as_matrix()
    return camera.transform(Pose(frame, frame, turn, camera.centre - turn @ camera.centre))


def _design(measured: VerticalParallax) -> np.ndarray:
    """Derivatives of the vertical parallax by the rotation of the right camera."""
    f = measured.geometry.focal_px
    cx, cy = measured.geometry.centre_px
    x = (measured.left[:, 0] - measured.parallax_px - cx) / f
    y = (measured.left[:, 1] - cy) / f
    return f * np.column_stack([1 + y * y, -x * y, -x])


def relative_orientation(
    measured: MeasuredOffsets, params: OrientationParams, applied: RelativeOrientation | None = None
) -> RelativeOrientation:
    """Least squares about the present orientation, which already includes `applied`."""
    rows = measured.rows
    across, along = _designs(rows)
    observed = [(across, rows.vertical_px)]
    if measured.predicted_px is not None:
        observed.append((along, rows.parallax_px - measured.predicted_px))
    shift_sigma = params.position_sigma_m / rows.geometry.base_m
    sigmas = np.r_[np.full(3, params.rotation_sigma), np.full(2, shift_sigma)]
    prior = np.r_[sigmas, params.rig_sigma_px * measured.rig_ratio] ** -2
    so_far = applied.unknowns if applied else np.zeros(6)
    solution, inverse = np.zeros(6), np.eye(6)
    for _ in range(STEPS):
        normal, right = np.diag(prior), -prior * so_far
        for design, value in observed:
            weight = _weights(value - design @ solution)
            normal = normal + (design * weight[:, None]).T @ design
            right = right + design.T @ (weight * value)
        inverse = np.linalg.inv(normal)
        solution = inverse @ right
    total = so_far[3:5] + solution[3:5]
    return RelativeOrientation(
        solution[:3],
        np.r_[0.0, solution[3:5]],
        inverse,
        np.r_[so_far[:3] + solution[:3], total, 0.0],
    )


def _weights(residual: PerPoint) -> PerPoint:
    """Inverse variances by the spread of the residuals, less for large ones."""
    middle = float(np.median(residual))
    scale = max(robust_sigma(residual - middle), FINEST_PX)
    return geman_mcclure_weights(residual - middle, scale) / scale**2


def _designs(rows: VerticalParallax) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of v and of p - q by w_x, w_y, w_z, t_y, t_z and s."""
    f, p = rows.geometry.focal_px, rows.parallax_px
    cx, cy = rows.geometry.centre_px
    x, y = (rows.left[:, 0] - p - cx) / f, (rows.left[:, 1] - cy) / f
    none, one = np.zeros_like(p), np.ones_like(p)
    across = np.column_stack([f * (1 + y * y), -f * x * y, -f * x, -p, p * y, none])
    along = np.column_stack([-f * x * y, f * (1 + x * x), -f * y, none, -p * x, one])
    return across, along
