"""Pictures of hypotheses: two stops from above, side by side, with the landmarks that agree."""

from __future__ import annotations

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Flags, Float64, Int32, Picture
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    CLIP,
    BirdsEyeParams,
    BirdsEyeView,
    PlaneFit,
    SearchGate,
    band_pass,
    channels,
    place_on,
)
from solmap.photogrammetry.matching.cross_site.hypotheses.features import (
    FeatureParams,
    conjugate_features,
    find_features,
)
from solmap.photogrammetry.matching.cross_site.hypotheses.voting import Landmarks

ENLARGED = 3
"""Picture elements to a cell along either axis."""
GAP_PX = 8
AROUND = (3.0, 0.05)
"""Metres and radians around a fit in which features are matched again for a picture."""
GOLDEN = 0.618
"""Hues advance by this share of the circle, so that neighbours differ."""


def draw_landmarks(
    views: tuple[BirdsEyeView, BirdsEyeView],
    landmarks: tuple[Landmarks, Landmarks],
    pairs: Int32[np.ndarray, "n 2"],
    fit: PlaneFit,
    params: BirdsEyeParams,
) -> Picture:
    """Both views, and a line between any two landmarks that the fit puts on the same place."""
    grounds = [_ground(view, params) for view in views]
    offset = grounds[0].shape[1] + GAP_PX
    picture = np.zeros((grounds[0].shape[0], offset + grounds[1].shape[1], 3), np.uint8)
    picture[:, : grounds[0].shape[1]], picture[:, offset:] = grounds
    agreeing = pairs[agrees_with_fit(landmarks, pairs, fit, 2 * views[0].cell_m)]
    starts, ends = (
        _pixels(marks.places[rows], view)
        for marks, rows, view in zip(landmarks, agreeing.T, views, strict=True)
    )
    for k, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        a, b = (start[0], start[1]), (end[0] + offset, end[1])
        cv2.line(picture, a, b, _colour(k), 1, cv2.LINE_AA)
        for place in (a, b):
            cv2.circle(picture, place, 4, _colour(k), 1, cv2.LINE_AA)
    return picture


def draw_features(
    earlier: BirdsEyeView,
    later: BirdsEyeView,
    fit: PlaneFit,
    birds_eye: BirdsEyeParams,
    params: FeatureParams,
) -> Picture:
    """Both views, and a line for every feature that is matched near a fit and agrees with it."""
    one, other = (find_features(view, birds_eye, params) for view in (earlier, later))
    around = SearchGate(fit.north_m, fit.east_m, *AROUND)
    pairs = conjugate_features(one, other, around, params)
    return draw_landmarks((earlier, later), (one.landmarks, other.landmarks), pairs, fit, birds_eye)


def agrees_with_fit(
    landmarks: tuple[Landmarks, Landmarks],
    pairs: Int32[np.ndarray, "n 2"],
    fit: PlaneFit,
    within_m: float,
) -> Flags:
    """Which pairs of landmarks a fit puts on the same place."""
    c, s = np.cos(fit.azimuth), np.sin(fit.azimuth)
    earlier, later = (m.places[rows] for m, rows in zip(landmarks, pairs.T, strict=True))
    moved = later @ np.array([[c, -s], [s, c]]).T + (fit.north_m, fit.east_m)
    return np.hypot(*(earlier - moved).T) < within_m


def _ground(view: BirdsEyeView, params: BirdsEyeParams) -> Picture:
    """Grey of a view without its long waves, black where nothing was seen."""
    grey = channels(view, params)[0]
    bright = np.where(grey.weight > 0, 40 + 160 * (grey.value + CLIP) / (2 * CLIP), 0)
    once = np.repeat(bright.astype(np.uint8)[..., None], 3, axis=2)
    return once.repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1)


def _colour(k: int) -> tuple[int, int, int]:
    """A bright colour, (red, green, blue)."""
    hue = np.array([[[round(180 * ((k * GOLDEN) % 1.0)) % 180, 220, 255]]], np.uint8)
    red, green, blue = cv2.cvtColor(hue, cv2.COLOR_HSV2RGB)[0, 0].tolist()
    return red, green, blue


def _pixels(places: Float64[np.ndarray, "n 2"], view: BirdsEyeView) -> Int32[np.ndarray, "n 2"]:
    """(column, row) in the picture of level places."""
    half = view.grey.shape[0] / 2
    at = np.column_stack([half + places[:, 1] / view.cell_m, half - places[:, 0] / view.cell_m])
    return np.round(at * ENLARGED).astype(np.int32)


def draw_overlay(earlier: BirdsEyeView, later: BirdsEyeView, fit: PlaneFit) -> Picture:
    """Both views in one picture, the earlier in red, the later in green and blue.

    Where they agree the picture is grey; where only one saw the ground it has that one's colour.
    """
    over = place_on(later.grey, later.cell_m, fit.azimuth, fit.north_m, fit.east_m)
    wave = 1.0 / earlier.cell_m
    red, cyan = (band_pass(grey, 0.8, wave) for grey in (earlier.grey, over))
    stretched = [
        np.where(c.weight > 0, 40 + 215 * (c.value + CLIP) / (2 * CLIP), 0).astype(np.uint8)
        for c in (red, cyan, cyan)
    ]
    return np.dstack(stretched)
