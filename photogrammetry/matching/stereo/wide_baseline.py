"""Wide-baseline stereo: two stops as a stereo pair with a baseline of metres, for far ground.

A baseline of 10 m resolves ground at 500 m like the rig's baseline of 0.2 m at 70 m (Di et al.
2008, section 5). On level ground the parallax of such a pair changes by B/h from row to row (B:
baseline, h: height of the mast), seven pixels with 10 m, which shears windows too much for
matching. The rig has measured the same ground coarsely, though: with the ray (x, y, 1) of a pixel
of the wide pair and (X, Y, Z) of equal length in the frame of the rig,

    q = p_rig (f B / f_rig B_rig) Z

predicts the parallax, B / B_rig times as uncertain as that of the rig. The right image is shifted
by q, smoothed; the remainder is small for any baseline. Only the rows with ground far enough for
the baseline are resampled and matched.

Where two views differ much, interest points of one are often not interest points of the other.
Windows about the interest points of the left image are therefore compared with every position
within reach, by normalised cross-correlation; the best position is matched back to the left image,
and a point that does not return to itself is dropped (`search_area`).

Two stops are not a rigid rig. Remaining errors of their relative orientation appear across the
epipolar lines and, against the prediction, along them; the right camera is corrected accordingly
(`orientation`). The rotation about the vertical, w_y, changes all parallaxes by f w_y, so its
standard deviation enters that of the parallax, and so does that of the baseline's length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar, runtime_checkable

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Bool, Float32, GreyImage, Int32, Mask, ParallaxMap, Vector3
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, epipolar_pair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.least_squares import match_offsets
from solmap.photogrammetry.matching.records import DenseMatches, EpipolarImages
from solmap.photogrammetry.matching.resampling import resample, shift_rows
from solmap.photogrammetry.matching.stereo.dense import DenseParams, match_about
from solmap.photogrammetry.matching.stereo.interest_points import (
    FoerstnerParams,
    interest_points,
)
from solmap.photogrammetry.matching.stereo.orientation import (
    FEWEST_OFFSETS,
    MeasuredOffsets,
    OrientationParams,
    RelativeOrientation,
    VerticalParallax,
    relative_orientation,
)
from solmap.photogrammetry.matching.stereo.semi_global import SemiGlobalParams
from solmap.photogrammetry.ranges import Factor, Metres, MetresOrZero, PixelsOrZero, Radians

ROUNDS = 2
"""Corrections of the right camera; the second changes hundredths of a pixel."""

OriginalImage = Float32[np.ndarray, "rows cols"]

OriginalMask = Bool[np.ndarray, "rows cols"]
"""Size of the image as taken, which is not that of the epipolar images."""

INTEREST = FoerstnerParams(smallest_weight=0.1, count=1200, cell_px=32)
"""Interest points of the left image: also in faint texture, and no more than needed."""

WINDOW_PX = 15
"""Side of the correlation window, odd, as in sparse matching (Di et al. 2008)."""

LEAST_CORRELATION = 0.8
"""Threshold of the normalised cross-correlation, as in sparse matching."""

LINES = 6
"""Rows searched to either side: 0.3 degrees of a Navcam."""

BACK_PX = 1
"""Largest difference after matching back: positions are whole pixels."""

REACH_LINES = 31
"""Rows matched beyond the requested ones: more than the reach of any window."""


@dataclass(frozen=True, slots=True)
class InstrumentLimits:
    """Which two pairs are used as a wide-baseline pair."""

    least_base_m: MetresOrZero = 2.0
    """Shortest baseline: shorter ones do not improve on the rig for ground that it maps itself."""
    largest_base_m: Metres = 40.0
    """Longest baseline; with longer ones the views of the requested ground differ too much."""
    least_angle: Radians = float(np.deg2rad(30.0))
    """Least angle between the baseline and either view: at 30 degrees half of the baseline is
    effective."""
    largest_turn: Radians = float(np.deg2rad(30.0))
    """Largest angle between the views: two thirds of a Navcam's field, of which a third is then
    shared."""


SMOOTHING_PX = 6.0
"""Standard deviation of the smoothing of the rig's parallax, so that its enlarged noise does not
distort the right image."""


@dataclass(frozen=True, slots=True)
class WideParams:
    """How two stops are matched as one stereo pair."""

    limits: InstrumentLimits = field(default_factory=InstrumentLimits)
    nearest_bases: Factor = 2.0
    """Nearest ground in units of the baseline: rays intersect at 27 degrees there. The prediction
    compensates the effect on the image of the ground, though not of rocks."""
    rig_error_px: PixelsOrZero = 0.5
    """Error of the rig's parallax, three standard deviations: limits the search."""
    orientation: OrientationParams = field(default_factory=OrientationParams)
    dense: DenseParams = field(
        default_factory=lambda: DenseParams(semi_global=SemiGlobalParams(uniqueness_percent=25))
    )
    """Less of a margin than for a rig: the prediction leaves few parallaxes to compare."""


@runtime_checkable
class Viewpoint(Protocol):
    """Data for choosing pairs; `WideBaselineImage` has them, and pairs that are not read yet."""

    @property
    def centre(self) -> Vector3:
        """Its position, in the LSL, metres."""

    @property
    def view(self) -> Vector3:
        """Direction of the middle of its image, in the LSL, of length one."""


L = TypeVar("L", bound=Viewpoint)


@dataclass(frozen=True, slots=True, eq=False)
class WideBaselineImage:
    """A matched pair of a stop, whose left image is one image of the wide pair."""

    pair_id: str
    image: OriginalImage
    """The left image as taken."""
    mask: OriginalMask
    camera: CameraModel
    """Its camera, in the LSL."""
    rig: EpipolarPair
    lsl_from_rig: Pose
    parallax: ParallaxMap
    """Dense parallax of the pair itself, on the grid of `rig`."""

    @property
    def size(self) -> tuple[int, int]:
        """Samples and lines of the image."""
        return self.image.shape[1], self.image.shape[0]

    @property
    def centre(self) -> Vector3:
        """Perspective centre of the left camera, in the LSL."""
        return self.camera.centre

    @property
    def view(self) -> Vector3:
        """Direction of the middle of the image, in the LSL."""
        middle = np.array([[(n - 1) / 2 for n in self.size]])
        return self.camera.rays(middle)[0]


@dataclass(frozen=True, slots=True, eq=False)
class WideBaselineMatches:
    """Dense parallax of a wide pair, and the correspondence of its rows."""

    images: EpipolarImages
    lsl_from_pair: Pose
    dense: DenseMatches
    orientation: RelativeOrientation
    rows_before: VerticalParallax
    rows_after: VerticalParallax


def order_left_right(one: L, other: L) -> tuple[L, L]:
    """The two images, the one further left first; down is the third axis."""
    forward = one.view + other.view
    right = np.array([-forward[1], forward[0], 0.0])
    return (one, other) if (other.centre - one.centre) @ right > 0 else (other, one)


def reason_against(left: Viewpoint, right: Viewpoint, limits: InstrumentLimits) -> str | None:
    """The reason against using two pairs as a wide pair; None if there is none."""
    base = right.centre - left.centre
    base_m = float(np.linalg.norm(base))
    if not limits.least_base_m <= base_m <= limits.largest_base_m:
        return f"a base of {base_m:.1f} m"
    turn = float(np.arccos(np.clip(left.view @ right.view, -1, 1)))
    if turn > limits.largest_turn:
        return f"views {np.rad2deg(turn):.0f} degrees apart"
    along = max(abs(float(eye.view @ base)) / base_m for eye in (left, right))
    if along > np.cos(limits.least_angle):
        return f"a view {np.rad2deg(np.arccos(min(along, 1.0))):.0f} degrees from the baseline"
    return None


def select_wide_pairs(
    ones: Sequence[L], others: Sequence[L], limits: InstrumentLimits
) -> list[tuple[L, L]]:
    """The wide pairs of two stops: every pair with the other that fits it best.

    Each comes in order, the left eye first.
    """
    chosen = []
    for one in ones:
        fit = [eye for eye in others if reason_against(*order_left_right(one, eye), limits) is None]
        if fit:
            chosen.append(
                order_left_right(one, max(fit, key=lambda eye: float(eye.view @ one.view)))
            )
    return chosen


def match_wide_baseline(
    left: WideBaselineImage, right: WideBaselineImage, params: WideParams | None = None
) -> WideBaselineMatches:
    """Dense parallax of the left images of two pairs at different stops.

    Raises:
        MatchingError: the two are not a wide pair, or share too little to estimate their relative
            orientation.
    """
    params = params or WideParams()
    against = reason_against(left, right, params.limits)
    if against:
        raise MatchingError(f"{left.pair_id} and {right.pair_id} are not a wide pair: {against}")
    smooth = _SmoothParallax.of(left.parallax, SMOOTHING_PX)
    warped = _PredictedPair.of(left, right, smooth, params)
    measured = before = warped.measure()
    found = relative_orientation(measured, params.orientation)
    for _ in range(ROUNDS):
        right = replace(right, camera=found.apply(right.camera, warped.images.geometry))
        warped = _PredictedPair.of(left, right, smooth, params)
        measured = warped.measure()
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
    return WideBaselineMatches(warped.images, pose, dense, found, before.rows, measured.rows)


@dataclass(frozen=True, slots=True, eq=False)
class _SmoothParallax:
    """Parallax of a rig averaged over its surroundings, pixels, and where enough of it is known."""

    values: ParallaxMap
    known: Mask

    @classmethod
    def of(cls, parallax: ParallaxMap, sigma_px: float) -> _SmoothParallax:
        known = np.isfinite(parallax)
        total = cv2.GaussianBlur(np.where(known, parallax, np.float32(0)), (0, 0), sigma_px)
        weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), sigma_px)
        enough = weight > 0.1  # noqa: PLR2004 - a corner of the window
        mean = np.where(enough, total / np.maximum(weight, np.float32(1e-3)), np.float32(0))
        return cls(mean, enough)


@dataclass(frozen=True, slots=True, eq=False)
class _PredictedPair:
    """Epipolar images of a wide pair with the parallax predicted from the rig."""

    images: EpipolarImages
    predicted: ParallaxMap
    rig_ratio: float
    """Parallax of the pair over that of the rig."""
    search: int
    """Search range in pixels to either side of the prediction."""

    @classmethod
    def of(
        cls,
        left: WideBaselineImage,
        right: WideBaselineImage,
        smooth: _SmoothParallax,
        params: WideParams,
    ) -> _PredictedPair:
        frame = Frame(FrameKind.PAIR, (*left.lsl_from_rig.source.index, -1))
        geometry = epipolar_pair(left.camera, right.camera, left.size, right.size, LSL, frame)
        predicted, seen = _predict_parallax(left, smooth, geometry)
        far = seen & (predicted <= geometry.focal_px / params.nearest_bases)
        rows = _rows_with(far)
        geometry = _cut(geometry, rows)
        grey_r, mask_r = resample(right.image, right.mask, right.camera, geometry, Eye.RIGHT)
        shared = _count_shared(predicted[rows], far[rows], mask_r)
        if shared < FEWEST_OFFSETS:
            raise MatchingError(
                f"{shared} pixels of the far ground in {left.pair_id} are predicted inside "
                f"{right.pair_id}, but the orientation of a wide pair needs {FEWEST_OFFSETS}"
            )
        grey_l, mask_l = resample(left.image, left.mask, left.camera, geometry, Eye.LEFT)
        images = EpipolarImages(geometry, grey_l, mask_l & far[rows], grey_r, mask_r)
        ratio = geometry.focal_px * geometry.base_m / (left.rig.focal_px * left.rig.base_m)
        search = int(np.ceil(params.rig_error_px * ratio))
        return cls(images, predicted[rows], ratio, search)

    def measure(self) -> MeasuredOffsets:
        """Offsets between the left image and the right one shifted by the prediction."""
        shifted_right = shift_rows(self.images.right, self.images.right_mask, self.predicted)
        images = replace(self.images, right=shifted_right[0], right_mask=shifted_right[1])
        found = search_area(images, self.search)
        if len(found.left) < FEWEST_OFFSETS:
            raise MatchingError(
                f"{len(found.left)} points of the wide pair were found in both images, but its "
                f"orientation needs {FEWEST_OFFSETS}: is the light alike, and do the views "
                "overlap?"
            )
        x, y = found.left.astype(int).T
        there = np.rint(found.left[:, 0] - found.parallax_px).astype(int)
        partner = self.predicted[y, there.clip(0, self.images.geometry.samples - 1)]
        rows = replace(found, parallax_px=found.parallax_px + partner)
        return MeasuredOffsets(rows, self.predicted[y, x].astype(np.float64), self.rig_ratio)


def _count_shared(predicted: ParallaxMap, far: Mask, right_mask: Mask) -> int:
    """Pixels of far ground in the left image whose predicted place in the right one is usable."""
    line, sample = np.nonzero(far)
    there = np.rint(sample - predicted[line, sample]).astype(np.int64)
    inside = (there >= 0) & (there < right_mask.shape[1])
    return int(right_mask[line[inside], there[inside]].sum())


def _rows_with(far: Mask) -> slice:
    """The rows that show far ground, with the reach of windows about them."""
    rows = np.flatnonzero(far.any(axis=1))
    if not len(rows):
        raise MatchingError("the wide pair shows no ground that is far enough for its baseline")
    return slice(max(0, int(rows[0]) - REACH_LINES), int(rows[-1]) + 1 + REACH_LINES)


def _cut(geometry: EpipolarPair, rows: slice) -> EpipolarPair:
    """The geometry of some rows of its images."""
    across, down = geometry.centre_px
    lines = min(rows.stop, geometry.lines) - rows.start
    return replace(geometry, centre_px=(across, down - rows.start), lines=lines)


def _predict_parallax(
    eye: WideBaselineImage, smooth: _SmoothParallax, geometry: EpipolarPair
) -> tuple[ParallaxMap, Mask]:
    """Parallax of the wide pair predicted from that of the left rig, pixels, and where it is known.

    The rays of both ideal cameras are related by a rotation, their image points by a homography.
    """
    rotation = eye.lsl_from_rig.rotation.T @ geometry.rover_from_pair.rotation
    rays = rotation @ np.linalg.inv(_calibration(geometry))
    to_rig = _calibration(eye.rig) @ rays
    size, inverse = (geometry.samples, geometry.lines), cv2.WARP_INVERSE_MAP
    parallax = cv2.warpPerspective(
        smooth.values,
        to_rig,
        size,
        flags=cv2.INTER_LINEAR | inverse,
        borderMode=cv2.BORDER_REPLICATE,
    )
    seen = cv2.warpPerspective(
        smooth.known.astype(np.uint8), to_rig, size, flags=cv2.INTER_NEAREST | inverse
    )
    sample, line = (np.arange(n, dtype=np.float32) for n in size)
    across, down, constant = rays[2].astype(np.float32)
    depth = across * sample + (down * line + constant)[:, None]
    ratio = geometry.focal_px * geometry.base_m / (eye.rig.focal_px * eye.rig.base_m)
    return parallax * (np.float32(ratio) * depth), (seen > 0) & (depth > 0)


def _calibration(geometry: EpipolarPair) -> np.ndarray:
    """K: the homogeneous image point of a ray (x, y, 1) is K (x, y, 1), in pixels."""
    (across, down), f = geometry.centre_px, geometry.focal_px
    return np.array([[f, 0.0, across], [0.0, f, down], [0.0, 0.0, 1.0]])


def search_area(images: EpipolarImages, reach_px: int) -> VerticalParallax:
    """Offsets, to a fraction of a pixel, of left points searched `reach_px` along their rows."""
    half = WINDOW_PX // 2
    margin = half + max(2, half // 2)
    found = interest_points(images.left, images.left_mask, INTEREST, margin).pixels
    reach = (reach_px, LINES)
    right, good = _best(images.left, images.right, found, reach)
    good &= images.right_mask[right[:, 1], right[:, 0]]
    left, right = found[good], right[good]
    back, good = _best(images.right, images.left, right, reach)
    good &= np.abs(back - left).max(axis=1, initial=0) <= BACK_PX
    left, start = left[good], (right - left)[good].astype(np.float64)
    offset = match_offsets(images, left, start, WINDOW_PX)
    settled = np.isfinite(offset).all(axis=1)
    return VerticalParallax(
        left[settled].astype(np.float64),
        offset[settled, 1],
        -offset[settled, 0],
        images.geometry,
    )


def _best(
    source: GreyImage,
    target: GreyImage,
    pixels: Int32[np.ndarray, "n 2"],
    reach: tuple[int, int],
) -> tuple[Int32[np.ndarray, "n 2"], np.ndarray]:
    """The position within reach with the best correlation for each pixel, and if it is good.

    A best position on the rim of the area is not a maximum.
    """
    half, (dx, dy) = WINDOW_PX // 2, reach
    border = (dy + half, dy + half, dx + half, dx + half)
    wide = cv2.copyMakeBorder(target, *border, cv2.BORDER_REPLICATE)
    places, good = pixels.copy(), np.zeros(len(pixels), dtype=bool)
    for k, (x, y) in enumerate(pixels.tolist()):
        window = source[y - half : y + half + 1, x - half : x + half + 1]
        if window.shape != (WINDOW_PX, WINDOW_PX):
            continue
        area = wide[y : y + 2 * (dy + half) + 1, x : x + 2 * (dx + half) + 1]
        score = cv2.matchTemplate(area, window, cv2.TM_CCOEFF_NORMED)
        _, best, _, (right, down) = cv2.minMaxLoc(score)
        inside = 0 < right < 2 * dx and 0 < down < 2 * dy
        good[k] = inside and best >= LEAST_CORRELATION
        places[k] = (x + right - dx, y + down - dy)
    limits = np.array([target.shape[1] - 1, target.shape[0] - 1])
    good &= ((places >= 0) & (places <= limits)).all(axis=1)
    return places.clip(0, limits).astype(np.int32), good
