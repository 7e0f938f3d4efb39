"""Two stops as one stereo instrument: a base of metres instead of the bar's, for far ground.

A base of 10 m resolves ground at 500 m as the bar of 0.2 m does at 70 m (Di et al. 2008, section
5). What makes such a pair hard also shows the way. On level ground its parallax changes by B/h from
row to row (B: base, h: height of the mast), seven pixels with 10 m, so windows shear beyond
recognition; but the bar has seen the same ground, if coarsely: with the ray (x, y, 1) of a pixel of
the wide pair and (X, Y, Z) of length alike in the frame of the bar,

    q = p_bar (f B / f_bar B_bar) Z

predicts the parallax, B / B_bar times as uncertain as that of the bar. The right image is shifted
by q, smoothed; what is left to find is small, whatever the base.

Two stops are no rigid bar. What adjustment leaves of their relative orientation shows across the
epipolar lines and, against the prediction, along them; the right camera is set right by that
(`relative_orientation`). The rotation about the vertical, w_y, goes into all parallaxes as f w_y,
so its standard deviation enters that of the parallax, and so does that of the base's length.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Mask, ParallaxMap
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, epipolar_pair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.area_search import AreaSearchParams, search_area
from solmap.photogrammetry.matching.dense import DenseMatches, DenseParams, match_about
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.relative_orientation import (
    Measured,
    OrientationParams,
    RelativeOrientation,
    relative_orientation,
)
from solmap.photogrammetry.matching.resampling import resample, shifted
from solmap.photogrammetry.matching.vertical_parallax import VerticalParallax
from solmap.photogrammetry.matching.wide_eyes import InstrumentLimits, WideEye, why_no_wide_pair

ROUNDS = 2
"""Times the right camera is set right; the second finds hundredths of a pixel."""


@dataclass(frozen=True, slots=True)
class WideParams:
    """How two stops are matched as one stereo instrument."""

    limits: InstrumentLimits = field(default_factory=InstrumentLimits)
    nearest_bases: float = 2.0
    """Nearest ground in units of the base: rays meet at 27 degrees there. The prediction takes out
    what that does to the look of the ground, though not of rocks."""
    bar_error_px: float = 0.5
    """What the bar's parallax may be wrong by, three standard deviations: sets the search."""
    smoothing_px: float = 6.0
    """Standard deviation of the smoothing of the bar's parallax, so that its noise, many times
    enlarged, does not wrinkle the right image."""
    search: AreaSearchParams = field(default_factory=AreaSearchParams)
    orientation: OrientationParams = field(default_factory=OrientationParams)
    dense: DenseParams = field(default_factory=DenseParams)


@dataclass(frozen=True, slots=True, eq=False)
class WideMatches:
    """Dense parallax of a wide pair, as that of any pair, and how well its rows corresponded."""

    images: EpipolarImages
    lsl_from_pair: Pose
    dense: DenseMatches
    orientation: RelativeOrientation
    rows_before: VerticalParallax
    rows_after: VerticalParallax


def match_wide(left: WideEye, right: WideEye, params: WideParams | None = None) -> WideMatches:
    """Dense parallax of the left images of two pairs at different stops.

    Raises:
        MatchingError: the two make no instrument, or share too little to tell how they stand.
    """
    params = params or WideParams()
    against = why_no_wide_pair(left, right, params.limits)
    if against:
        raise MatchingError(f"{left.pair_id} and {right.pair_id} make no wide pair: {against}")
    warped = _Warped.of(left, right, params)
    measured = before = warped.measured(params)
    found = relative_orientation(measured, params.orientation)
    for _ in range(ROUNDS):
        right = replace(right, camera=found.applied(right.camera, warped.images.geometry))
        warped = _Warped.of(left, right, params)
        measured = warped.measured(params)
        found = relative_orientation(measured, params.orientation, found)
    geometry = warped.images.geometry
    dense = match_about(warped.images, warped.predicted, warped.search, params.dense)
    shared = found.shared_sigma(geometry, params.orientation)
    stretched = np.hypot(
        np.float32(shared.offset_px), np.float32(shared.stretch) * dense.parallax_px
    )
    sigma = np.hypot(dense.sigma_px, stretched)
    pose = geometry.rover_from_pair
    dense = DenseMatches(dense.parallax_px, sigma, shared)
    return WideMatches(warped.images, pose, dense, found, before.rows, measured.rows)


@dataclass(frozen=True, slots=True, eq=False)
class _Warped:
    """Epipolar images of a wide pair with the parallax that the bar predicts."""

    images: EpipolarImages
    predicted: ParallaxMap
    bar_ratio: float
    """Parallax of the pair over that of the bar."""
    search: int
    """Pixels to either side of the prediction that are searched."""

    @classmethod
    def of(cls, left: WideEye, right: WideEye, params: WideParams) -> _Warped:
        frame = Frame(FrameKind.PAIR, (*left.lsl_from_bar.source.index, -1))
        geometry = epipolar_pair(left.camera, right.camera, left.size, right.size, LSL, frame)
        grey_l, mask_l = resample(left.image, left.mask, left.camera, geometry, Eye.LEFT)
        grey_r, mask_r = resample(right.image, right.mask, right.camera, geometry, Eye.RIGHT)
        predicted, known = predicted_parallax(left, geometry, params.smoothing_px)
        mask_l &= known & (predicted <= geometry.focal_px / params.nearest_bases)
        images = EpipolarImages(geometry, grey_l, mask_l, grey_r, mask_r)
        ratio = geometry.focal_px * geometry.base_m / (left.bar.focal_px * left.bar.base_m)
        return cls(images, predicted, ratio, int(np.ceil(params.bar_error_px * ratio)))

    def measured(self, params: WideParams) -> Measured:
        """Offsets between the left image and the right one shifted by the prediction."""
        shifted_right = shifted(self.images.right, self.images.right_mask, self.predicted)
        images = replace(self.images, right=shifted_right[0], right_mask=shifted_right[1])
        found = search_area(images, self.search, params.search)
        if len(found.left) < params.orientation.fewest_points:
            raise MatchingError(
                f"{len(found.left)} points of the wide pair were found in both images, of "
                f"{params.orientation.fewest_points} that its orientation takes: is the light "
                "alike, and do the views overlap?"
            )
        x, y = found.left.astype(int).T
        there = np.rint(found.left[:, 0] - found.parallax_px).astype(int)
        partner = self.predicted[y, there.clip(0, self.images.geometry.samples - 1)]
        rows = replace(found, parallax_px=found.parallax_px + partner)
        return Measured(rows, self.predicted[y, x].astype(np.float64), self.bar_ratio)


def predicted_parallax(
    eye: WideEye, geometry: EpipolarPair, smoothing_px: float
) -> tuple[ParallaxMap, Mask]:
    """Parallax in the wide pair as the bar of its left eye has seen it, and where that is known."""
    smooth, known = _smoothed(eye.parallax, smoothing_px)
    rotation = eye.lsl_from_bar.rotation.T @ geometry.rover_from_pair.rotation
    r = rotation.astype(np.float32)
    line, sample = np.indices((geometry.lines, geometry.samples), dtype=np.float32)
    x = (sample - np.float32(geometry.centre_px[0])) / np.float32(geometry.focal_px)
    y = (line - np.float32(geometry.centre_px[1])) / np.float32(geometry.focal_px)
    X, Y, Z = (r[i, 0] * x + r[i, 1] * y + r[i, 2] for i in range(3))
    Z = np.maximum(Z, np.float32(1e-3))
    f = np.float32(eye.bar.focal_px)
    u, v = eye.bar.centre_px[0] + f * X / Z, eye.bar.centre_px[1] + f * Y / Z
    at = (u.astype(np.float32), v.astype(np.float32))
    bar = cv2.remap(smooth, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen = cv2.remap(known.astype(np.uint8), *at, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    ratio = geometry.focal_px * geometry.base_m / (eye.bar.focal_px * eye.bar.base_m)
    return (bar * np.float32(ratio) * Z).astype(np.float32), seen > 0


def _smoothed(parallax: ParallaxMap, sigma_px: float) -> tuple[ParallaxMap, Mask]:
    """Parallax averaged over its surroundings, and where enough of it is there."""
    known = np.isfinite(parallax)
    total = cv2.GaussianBlur(np.where(known, parallax, np.float32(0)), (0, 0), sigma_px)
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), sigma_px)
    enough = weight > 0.1  # noqa: PLR2004 - a corner of the window
    return np.where(enough, total / np.maximum(weight, np.float32(1e-3)), np.float32(0)), enough
