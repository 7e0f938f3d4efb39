"""What is left of the parallax across the epipolar line, and the rotation of the bar it tells of.

Rows of an epipolar pair correspond exactly if the stereo bar is as its camera models say. A bar
that has bent, or models of another exposure, show as a vertical parallax v = y_r - y_l. A small
rotation w of the right camera about the (right, down, forward) axes turns the directions
d = (x, y, 1) that it sees by -w x d, and so moves its image points down by

    v = f [ w_x (1 + y^2) - w_y x y - w_z x ]

with x, y in units of f from the common axis. Estimated by least squares with blunders weighted
down, w is by how much the right camera really stands turned from its model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import ImagePoints, PerPoint, Vector3
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Frame, Pose
from solmap.photogrammetry.matching.interest_points import strongest_by_cell
from solmap.photogrammetry.matching.least_squares import refined_offsets
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.sparse import SparseParams, match_interest_points
from solmap.photogrammetry.robust import robust_sigma

LINE_TOLERANCE_PX = 6
"""Rows searched to either side: 0.3 degrees of a Navcam, twice what real bars were off."""

MOST_POINTS = 800
"""Points measured in both directions; the median of a hundredth of a pixel needs no more."""

FEWEST_POINTS = 12
"""Four times the three unknowns."""

WRONG_BAR_PX = 0.5
"""Vertical parallax above which the camera models do not fit the images: windows of 15 pixels
matched half a row off lose about a tenth of their correlation."""


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
    def fits_the_bar(self) -> bool:
        """Whether the rows correspond as the camera models say."""
        enough = len(self.vertical_px) >= FEWEST_POINTS
        return bool(enough and max(abs(self.median_px), self.mad_px) <= WRONG_BAR_PX)

    def __str__(self) -> str:
        verdict = "rows correspond"
        if len(self.vertical_px) < FEWEST_POINTS:
            verdict = "too few to tell whether the camera models fit the images"
        elif not self.fits_the_bar:
            verdict = (
                "the camera models do not fit the images: another exposure, or a bent stereo bar"
            )
        return (
            f"vertical parallax {self.median_px:+.2f} px (MAD {self.mad_px:.2f}) at "
            f"{len(self.vertical_px)} points: {verdict}"
        )


def vertical_parallax(
    images: EpipolarImages, params: SparseParams | None = None
) -> VerticalParallax:
    """Vertical parallax at well-spread interest points, to a fraction of a pixel."""
    wide = replace(params or SparseParams(), line_tolerance_px=LINE_TOLERANCE_PX)
    candidates = match_interest_points(images, wide)
    left = candidates.left[candidates.accepted]
    right = candidates.right[candidates.accepted]
    kept = strongest_by_cell(
        left.astype(float), candidates.correlation[candidates.accepted], 48, MOST_POINTS
    )
    left, right = left[kept], right[kept]
    offset = refined_offsets(images, left, (right - left).astype(np.float64), wide.window_px)
    good = np.isfinite(offset).all(axis=1)
    return VerticalParallax(
        left[good].astype(np.float64), offset[good, 1], -offset[good, 0], images.geometry
    )


def rotation_of_the_bar(measured: VerticalParallax, steps: int = 10) -> Vector3:
    """Rotation vector (right, down, forward axes; radians) of the right camera from its model."""
    if len(measured.left) < FEWEST_POINTS:
        raise MatchingError(
            f"{len(measured.left)} points with vertical parallax are too few to tell a rotation of "
            f"the stereo bar from; {FEWEST_POINTS} are needed"
        )
    design = _design(measured)
    weight = np.ones(len(design))
    rotation = np.zeros(3)
    for _ in range(steps):
        normal = (design * weight[:, None]).T @ design
        rotation = np.linalg.solve(normal, design.T @ (weight * measured.vertical_px))
        residual = measured.vertical_px - design @ rotation
        scale = max(robust_sigma(residual), 1e-3)
        weight = 1.0 / (1.0 + (residual / (2.0 * scale)) ** 2) ** 2
    return rotation


def straightened(right: CameraModel, geometry: EpipolarPair, rotation: Vector3) -> CameraModel:
    """The right camera model, given in the rover frame, turned to where it really points."""
    rover_from_pair = geometry.rover_from_pair
    return turned_in_place(right, rover_from_pair.target, rover_from_pair.rotation @ rotation)


def turned_in_place(camera: CameraModel, frame: Frame, rotation: Vector3) -> CameraModel:
    """A camera turned about its own centre by a rotation vector, both in the same frame."""
    turn = ScipyRotation.from_rotvec(rotation).as_matrix()
    return camera.moved(Pose(frame, frame, turn, camera.centre - turn @ camera.centre))


def _design(measured: VerticalParallax) -> np.ndarray:
    """Derivatives of the vertical parallax by the rotation of the right camera."""
    f = measured.geometry.focal_px
    cx, cy = measured.geometry.centre_px
    x = (measured.left[:, 0] - measured.parallax_px - cx) / f
    y = (measured.left[:, 1] - cy) / f
    return f * np.column_stack([1 + y * y, -x * y, -x])
