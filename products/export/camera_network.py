"""Cameras and tie points of an adjusted network, for other programs.

The cameras are those of the epipolar images in which ties were measured: perspective, without
distortion, and with square pixels, so that any program models them exactly. Both cameras of a pair
share focal length, image centre and size; an image without partner is one camera. A tie point that
was measured in a pair at (x, y) with the parallax p is at (x, y) in the left image and at
(x - p, y) in the right one.

Points are in metres of the map (east, north, up), rotations from the camera (right, down, forward)
to the map. Image points have (0, 0) at the centre of the first pixel. Observations that the
adjustment set aside are left out, and so are tie points in fewer than two of the images.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import USED, AdjustedPair
from solmap.photogrammetry.arrays import (
    Covariances3,
    GreyImage,
    ImagePoints,
    Int32,
    Mask,
    ObjectPoints,
    PerPoint,
    Rotation,
    Vector3,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, single_image
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.resampling import resample
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.images import image_file, read_product_image
from solmap.products.catalogue.oriented_images import OrientedMission, geometry_of, matches_of
from solmap.products.crs import LandingPoint

_FEWEST_VIEWS = 2
_DARKEST = 1
"""Darkest grey value of an image; 0 means no data."""
_PERCENTILES = (0.5, 99.5)
"""Percentiles of brightness, shown black and white."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
    """One epipolar image with its pose."""

    entry: ImageEntry
    camera: int
    """Number of the camera: the two images of a pair have one in common."""
    geometry: EpipolarPair
    map_from_camera: Rotation
    centre_m: Vector3

    @property
    def name(self) -> str:
        """The image's identifier."""
        return self.entry.id

    def project(self, points: ObjectPoints) -> ImagePoints:
        """Image points of points on the map; NaN behind the camera."""
        seen = (points - self.centre_m) @ self.map_from_camera
        depth = np.where(seen[:, 2] > 0, seen[:, 2], np.nan)
        plane = seen[:, :2] / depth[:, None]
        return plane * self.geometry.focal_px + np.asarray(self.geometry.centre_px)


@dataclass(frozen=True, slots=True, eq=False)
class CameraNetwork:
    """Cameras, tie points and their observations: row k sees `point[k]` in `view[k]`."""

    views: tuple[CameraView, ...]
    points: ObjectPoints
    covariances: Covariances3
    """Covariances of the points, square metres; axes as of the points."""
    view: Int32[np.ndarray, " n"]
    point: Int32[np.ndarray, " n"]
    at: ImagePoints
    sigma_px: PerPoint

    def residuals_px(self) -> ImagePoints:
        """Measured minus projected."""
        found = np.empty_like(self.at)
        for number, view in enumerate(self.views):
            rows = np.flatnonzero(self.view == number)
            found[rows] = self.at[rows] - view.project(self.points[self.point[rows]])
        return found


def body_fixed(landing: LandingPoint) -> tuple[Rotation, Vector3]:
    """Rotation and origin of the map (east, north, up) in the body-fixed frame, metres.

    The map is the plane tangent to the sphere of radius R at the landing point (longitude l,
    latitude p), so that (east, north, up) lie at

        R u + east e + north n + up u,      u = (cos p cos l, cos p sin l, sin p)
        e = (-sin l, cos l, 0)              n = (-sin p cos l, -sin p sin l, cos p)
    """
    lon, lat = np.radians([landing.longitude, landing.latitude])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    return np.column_stack([east, np.cross(up, east), up]), landing.radius_m * up


def camera_network(mission: OrientedMission, chosen: Collection[str]) -> CameraNetwork:
    """Cameras and tie points of the selected images of a mission."""
    images = mission.workspace.catalogue.images(mission.network.mission)
    entries = {entry.id: entry for entry in images}
    views: list[CameraView] = []
    at_pair: dict[str, tuple[int, int | None]] = {}
    for number, pair in enumerate(mission.network.adjusted.pairs):
        if pair.pair_id in chosen and pair.pair_id in entries:
            of_pair = list(_views(number, pair, entries, mission))
            right = len(views) + 1 if len(of_pair) > 1 else None
            at_pair[pair.pair_id] = len(views), right
            views += of_pair
    return _with_ties(tuple(views), at_pair, mission)


def _views(
    number: int, pair: AdjustedPair, entries: dict[str, ImageEntry], mission: OrientedMission
) -> Iterator[CameraView]:
    entry = entries[pair.pair_id]
    matches = matches_of(entry, mission.workspace) if entry.partner else None
    if matches is None:
        image = mission.record(entry)
        size, frame = (image.samples, image.lines), pair.lsl_from_pair.source
        geometry = single_image(image.camera, size, image.stop.frame, frame)
    else:
        geometry = geometry_of(matches, mission.workspace)
    turn = MAP_FROM_LSL @ pair.lsl_from_pair.rotation
    centre = MAP_FROM_LSL @ pair.lsl_from_pair.translation_m
    yield CameraView(entry, number, geometry, turn, centre)
    if matches is not None and entry.partner is not None:
        right = centre + geometry.base_m * turn[:, 0]
        yield CameraView(entries[entry.partner], number, geometry, turn, right)


def _with_ties(
    views: tuple[CameraView, ...],
    at_pair: dict[str, tuple[int, int | None]],
    mission: OrientedMission,
) -> CameraNetwork:
    ties = mission.network.adjusted.ties
    seen = ties.observations
    numbers = [at_pair.get(name, (-1, None)) for name in seen.pair_ids]
    left = np.array([one for one, _ in numbers], dtype=np.int32)
    right = np.array([-1 if other is None else other for _, other in numbers], dtype=np.int32)
    placed = np.isfinite(ties.points).all(axis=1)
    used = np.flatnonzero((ties.status == USED) & placed[seen.point] & (left[seen.pair] >= 0))
    both = used[np.isfinite(seen.parallax_px[used]) & (right[seen.pair[used]] >= 0)]
    shifted = seen.left[both] - np.column_stack([seen.parallax_px[both], np.zeros(len(both))])
    view = np.concatenate([left[seen.pair[used]], right[seen.pair[both]]])
    point = np.concatenate([seen.point[used], seen.point[both]])
    at = np.concatenate([seen.left[used], shifted])
    of_right = np.hypot(seen.sigma_px, seen.sigma_parallax_px)[both]
    sigma = np.concatenate([seen.sigma_px[used], of_right])
    kept = np.flatnonzero(np.bincount(point, minlength=len(ties.points))[point] >= _FEWEST_VIEWS)
    kept = kept[np.lexsort((view[kept], point[kept]))]
    held, renumbered = np.unique(point[kept], return_inverse=True)
    turn = np.asarray(MAP_FROM_LSL, dtype=np.float64)
    return CameraNetwork(
        views,
        ties.points[held] @ turn.T,
        turn @ ties.covariances[held] @ turn.T,
        view[kept].astype(np.int32),
        renumbered.astype(np.int32),
        at[kept],
        sigma[kept],
    )


def view_image(view: CameraView, mission: OrientedMission) -> bytes:
    """The epipolar image of a camera as 8-bit PNG, 0 where it has no data."""
    read = read_product_image(image_file(view.entry), mission.workspace.store)
    eye = Eye.RIGHT if view.entry.eye == Eye.RIGHT else Eye.LEFT
    camera = mission.record(view.entry).camera
    image, mask = resample(read.pixels, read.mask, camera, view.geometry, eye)
    return bytes(cv2.imencode(".png", _grey(image, mask))[1])


def _grey(image: GreyImage, mask: Mask) -> np.ndarray:
    seen = image[mask]
    low, high = np.percentile(seen, _PERCENTILES) if seen.size else (0.0, 1.0)
    scale = (255.0 - _DARKEST) / max(float(high - low), 1e-6)
    grey = np.clip(_DARKEST + (image - low) * scale, _DARKEST, 255.0)
    return np.where(mask, np.rint(grey), 0).astype(np.uint8)
