"""A stop prepared for linking: its ground as a surface, and patches resampled from its images.

At a grazing angle of 8 degrees a bump of 5 cm shifts the points on it by 35 cm along the view, and
in the opposite direction when seen from the other side. Patches of two stops are therefore compared
as orthophotos: every cell of a patch has its elevation from the dense parallax of its own stop, a
surface without gaps (`GroundSurface`), and is projected into the image,

    grey(n, e) = image( h( pair_from_level (n, e, -elevation(n, e)) ) ).

With D the derivative of the image point by (n, e) over that surface, a pixel covers the ellipse C =
D^-1 D^-T of the ground: Z/f across the view and Z^2/(f h) along it on level ground, h being the
height of the mast; more on ground that slopes away from the camera. Detail can only be averaged, so
the cells of a patch common to two images are as large as the larger pixel of the two in all
directions: with C_1 = L L' and L^-1 C_2 L^-T = V diag(l) V', place = centre + G (row, column),

    G = L V diag(sqrt(max(1, l))),

and each image is averaged over the pixels that a cell covers. Patches to be matched with a stop
under another sun are relit over the same surface (`light`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from solmap.photogrammetry.arrays import (
    Flags,
    Float32,
    Float64,
    ObjectPoints,
    PerPoint,
    Raster,
    Vector3,
)
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.conjugates import TieView
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    BirdsEyeParams,
    BirdsEyeView,
    draw_birds_eye,
)
from solmap.photogrammetry.matching.cross_site.ground_grid import GroundGrid
from solmap.photogrammetry.matching.cross_site.light import relighting, slopes
from solmap.photogrammetry.matching.cross_site.surface_alignment import SurfaceParams
from solmap.photogrammetry.matching.records import MatchedStop

SLOPE_STEP_M = 0.25

LEAST_SEEN = 0.7
"""Fraction of a patch whose surface must be known."""

WIDEST_AVERAGE = 5
"""Largest power of two of pixels that are averaged into one."""

FILL_CELLS = (1.0, 3.0, 8.0)
"""Standard deviations of the Gaussians that fill gaps from neighbours, nearest first."""

LONGEST = 4.0
"""Largest ratio of a cell's length to its width: a narrower strip contains too little."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundSurface:
    """Elevation around a stop in its level frame, without gaps near what was measured."""

    cell_m: float
    elevation: Raster
    rise: Float32[np.ndarray, "2 rows cols"]
    """Gradient towards north and east."""

    @classmethod
    def of(cls, view: BirdsEyeView) -> GroundSurface:
        """Fill the gaps between the measured cells of a bird's-eye view."""
        seen = np.isfinite(view.elevation)
        value = np.nan_to_num(view.elevation)
        filled = view.elevation.copy()
        for sigma in FILL_CELLS:
            density = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), sigma)
            mean = cv2.GaussianBlur(value, (0, 0), sigma) / np.maximum(density, 1e-6)
            near = np.isnan(filled) & (density > 0.02)  # noqa: PLR2004 - something within 2 sigma
            filled[near] = mean[near]
        known = np.isfinite(filled)
        inner = cv2.erode(known.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        smooth = cv2.medianBlur(np.where(known, filled, 0).astype(np.float32), 5)
        elevation = np.where(inner, smooth, filled).astype(np.float32)
        return cls(view.cell_m, elevation, slopes(elevation, view.cell_m))

    def at(self, north: np.ndarray, east: np.ndarray) -> Float32[np.ndarray, "a b"]:
        """Elevation at places of the level frame, NaN where unknown."""
        return self._sample(self.elevation, north, east)

    def relighting(
        self, north: np.ndarray, east: np.ndarray, sun: Vector3, other: Vector3
    ) -> Float32[np.ndarray, "a b"]:
        """Ratio of the ground's brightness under another sun; NaN beyond the surface."""
        north_rise, east_rise = (self._sample(raster, north, east) for raster in self.rise)
        return relighting(north_rise, east_rise, sun, other)

    def _sample(
        self, raster: Raster, north: np.ndarray, east: np.ndarray
    ) -> Float32[np.ndarray, "a b"]:
        """A raster of the surface at places of the level frame."""
        if not north.size:
            return np.zeros(north.shape, np.float32)
        half = self.elevation.shape[0] / 2 - 0.5
        col = (east / self.cell_m + half).astype(np.float32)
        row = (half - north / self.cell_m).astype(np.float32)
        return cv2.remap(
            raster,
            col,
            row,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        ).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class MatchedGround:
    """Positions of the sparse matches of a pair in the level frame of its stop."""

    places: ObjectPoints
    range_m: PerPoint
    """Range along the axis of the pair."""
    footprints: Float64[np.ndarray, "n 2 2"]
    """C of a pixel at every place, square metres; NaN where unknown."""


@dataclass(slots=True, eq=False)
class GroundView:
    """One pair of a stop as a camera in the level frame."""

    view: TieView
    surface: GroundSurface
    rotation: Float64[np.ndarray, "3 3"]
    """level_from_pair."""
    origin_m: Float64[np.ndarray, " 3"]
    _ground: MatchedGround | None = None

    @property
    def sun(self) -> Vector3 | None:
        """Unit vector towards the Sun in the level frame (north, east, down), if known."""
        return self.view.pair.sun

    @property
    def ground(self) -> MatchedGround:
        """The ground of the pair's sparse matches, computed once."""
        if self._ground is None:
            matches, geometry = self.view.pair.matches, self.view.geometry
            ahead = matches.parallax_px > 0
            points = geometry.triangulate(matches.left[ahead], matches.parallax_px[ahead])
            places = points @ self.rotation.T + self.origin_m
            self._ground = MatchedGround(places, points[:, 2], self.footprints(places[:, :2]))
        return self._ground

    @classmethod
    def of(
        cls, view: TieView, surface: GroundSurface, level_from_rover: Float64[np.ndarray, "3 3"]
    ) -> GroundView:
        """A pair in the level frame of its stop."""
        pose = view.geometry.rover_from_pair
        return cls(
            view, surface, level_from_rover @ pose.rotation, level_from_rover @ pose.translation_m
        )

    def project(self, north: np.ndarray, east: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(left image points, ranges) of the ground at level places; NaN where unknown."""
        down = -self.surface.at(np.atleast_2d(north), np.atleast_2d(east)).astype(np.float64)
        level = np.stack([north.ravel(), east.ravel(), down.ravel()], axis=1)
        points = (level - self.origin_m) @ self.rotation
        left, _ = self.view.geometry.project(points)
        return left, points[:, 2]

    def derivative(self, places: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2 2"]:
        """Pixels per metre along north and east at level places, over half a metre of ground."""
        columns = []
        for step in np.eye(2) * SLOPE_STEP_M:
            ahead, _ = self.project(*(places + step).T)
            behind, _ = self.project(*(places - step).T)
            columns.append((ahead - behind) / (2 * SLOPE_STEP_M))
        return np.stack(columns, axis=-1)

    def footprints(self, places: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2 2"]:
        """C of a pixel at level places, square metres; NaN where the ground is unknown.

        A slope that faces the camera does not reduce it below that of level ground.
        """
        derivative = self.derivative(places)
        good = np.isfinite(derivative).all(axis=(1, 2))
        longest = np.full(len(places), np.nan)
        longest[good] = 1 / np.maximum(smallest_stretch(derivative[good]), 1e-3)
        ahead = places - self.origin_m[:2]
        distance = np.maximum(np.hypot(*ahead.T), 0.1)
        focal = self.view.geometry.focal_px
        along = np.maximum(longest, distance**2 / (focal * max(-self.origin_m[2], 0.5)))
        across = distance / focal
        u = ahead / distance[:, None]
        n = np.column_stack([-u[:, 1], u[:, 0]])
        along_c, across_c = (
            (size**2)[:, None, None] * axis[:, :, None] * axis[:, None, :]
            for size, axis in ((along, u), (across, n))
        )
        return along_c + across_c

    def draw_patches(
        self,
        centres: Float64[np.ndarray, "n 2"],
        grids: Float64[np.ndarray, "n 2 2"],
        half: int,
        core_half: int,
        sun: Vector3 | None = None,
    ) -> tuple[Float32[np.ndarray, "n a a"], Flags]:
        """Orthophoto patches around (north, east) centres, and whether their core is visible.

        Row i and column j of a patch lie at centre + G (i - half, j - half). Given a sun, the
        patches are relit for it.
        """
        places = _places(centres, grids, half)
        n, size = places.shape[:2]
        flat = places.reshape(n * size, size, 2)
        left = self.project(flat[..., 0], flat[..., 1])[0]
        left = left.reshape(n, size, size, 2)
        patches = np.zeros((n, size, size), np.float32)
        levels = self._levels(centres, grids)
        for patch, points, (across, down) in zip(patches, left, levels.tolist(), strict=True):
            patch[:] = self._sample(points, (across, down))
        if sun is not None and self.sun is not None:
            brighter = self.surface.relighting(flat[..., 0], flat[..., 1], self.sun, sun)
            patches *= brighter.reshape(patches.shape)
        core = slice(half - core_half, half + core_half + 1)
        whole = np.isfinite(patches[:, core, core]).reshape(n, -1).mean(axis=1) > LEAST_SEEN
        middle = slice(half - core_half // 2, half + core_half // 2 + 1)
        whole &= self._inside(left[:, middle, middle]).reshape(n, -1).all(axis=1)
        means = np.nanmean(np.where(whole[:, None, None], patches, 0.0), axis=(1, 2))
        return np.where(np.isfinite(patches), patches, means[:, None, None]).astype(
            np.float32
        ), whole

    def relief_m(
        self, centres: Float64[np.ndarray, "n 2"], grids: Float64[np.ndarray, "n 2 2"], half: int
    ) -> PerPoint:
        """Root mean square height of the ground of patches relative to its mean plane."""
        places = _places(centres, grids, half)
        n, size = places.shape[:2]
        flat = places.reshape(n * size, size, 2)
        up = self.surface.at(flat[..., 0], flat[..., 1]).reshape(n, size * size).astype(np.float64)
        up = np.nan_to_num(up - np.nanmean(up, axis=1, keepdims=True))
        row, col = np.indices((size, size)).reshape(2, -1) - half
        plane, _ = np.linalg.qr(np.column_stack([np.ones(size * size), row, col]))
        return np.sqrt(np.mean((up - up @ plane @ plane.T) ** 2, axis=1))

    def _levels(
        self, centres: Float64[np.ndarray, "n 2"], grids: Float64[np.ndarray, "n 2 2"]
    ) -> np.ndarray:
        """Powers of two of pixels to average along samples and lines, for every patch."""
        pixels = np.linalg.norm(self.derivative(centres) @ grids, axis=2)
        pixels = np.maximum(np.nan_to_num(pixels, nan=1.0), 1.0)
        return np.clip(np.round(np.log2(pixels)), 0, WIDEST_AVERAGE).astype(np.int64)

    def _sample(self, left: np.ndarray, level: tuple[int, int]) -> np.ndarray:
        """Grey values at image points of a patch, from the image averaged as required."""
        image, width = self.view.left.image, (2 ** level[0], 2 ** level[1])
        part = _part_around(left, image.shape, max(width))
        if part is None:
            return np.full(left.shape[:2], np.nan, np.float32)
        rows, cols = part
        image = image[rows, cols]
        # an even box is centred half a pixel too early
        shift = [0.5 if k else 0.0 for k in level]
        return cv2.remap(
            image if level == (0, 0) else cv2.blur(image, width),
            (left[..., 0] + shift[0]).astype(np.float32) - np.float32(cols.start),
            (left[..., 1] + shift[1]).astype(np.float32) - np.float32(rows.start),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        )

    def _inside(self, left: np.ndarray) -> np.ndarray:
        """Whether image points lie on usable pixels."""
        mask = self.view.left.mask
        with np.errstate(invalid="ignore"):
            col, row = (
                np.nan_to_num(np.round(left[..., k]), nan=-1).astype(np.int64) for k in (0, 1)
            )
        lines, samples = mask.shape
        inside = (col >= 0) & (row >= 0) & (col < samples) & (row < lines)
        return inside & mask[np.clip(row, 0, lines - 1), np.clip(col, 0, samples - 1)]


@dataclass(frozen=True, slots=True, eq=False)
class StopViews:
    """A stop prepared for linking; reused when it is linked more than once."""

    stop: MatchedStop
    birds_eye: BirdsEyeView
    views: tuple[GroundView, ...]
    _heights: dict[SurfaceParams, GroundGrid] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, stop: MatchedStop, params: BirdsEyeParams) -> StopViews:
        """Rasterise the stop's ground, coarsely for the search, finely for its pairs' patches."""
        seen, fine = draw_birds_eye(stop, params, (params.cell_m, params.surface_cell_m))
        surface = GroundSurface.of(fine)
        level = stop.lsl_from_rover.rotation
        views = tuple(GroundView.of(TieView(pair), surface, level) for pair in stop.pairs)
        return cls(stop, seen, views)

    def heights(self, params: SurfaceParams) -> GroundGrid:
        """The heights of its ground, computed once."""
        if params not in self._heights:
            self._heights[params] = GroundGrid.of(self.stop, params.cell_m, params.farthest_m)
        return self._heights[params]

    @property
    def id(self) -> StopId:
        """Identifier of the stop."""
        return self.stop.stop

    @property
    def pair_ids(self) -> tuple[str, ...]:
        """Its pairs, in the order of `views`."""
        return tuple(view.view.pair.pair_id for view in self.views)


def _part_around(
    points: Float64[np.ndarray, "a a 2"], shape: tuple[int, int], margin_px: int
) -> tuple[slice, slice] | None:
    """Rows and columns of an image that hold some points and a margin; None if none lies in it."""
    known = points[np.isfinite(points).all(axis=2)]
    if not len(known):
        return None
    first = np.maximum(np.floor(known.min(axis=0)).astype(np.int64) - margin_px, 0)
    last = np.minimum(np.ceil(known.max(axis=0)).astype(np.int64) + margin_px + 1, shape[::-1])
    if (last <= first).any():
        return None
    return slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))


def _places(
    centres: Float64[np.ndarray, "n 2"], grids: Float64[np.ndarray, "n 2 2"], half: int
) -> Float64[np.ndarray, "n a a 2"]:
    """(north, east) of the cells of patches."""
    steps = np.arange(-half, half + 1, dtype=np.float64)
    plan = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    return centres[:, None, None, :] + np.einsum("nab,ijb->nija", grids, plan)


def common_cells(
    one: Float64[np.ndarray, "n 2 2"], other: Float64[np.ndarray, "n 2 2"], square_m: float
) -> Float64[np.ndarray, "n 2 2"]:
    """G of cells as large as the larger of two images' pixels, C_1 and C_2, in every direction.

    Cells up to the length `square_m` are square, longer ones narrower, at least of that area; NaN
    where either C is not finite.
    """
    cells = np.full(one.shape, np.nan)
    good = np.isfinite(one).all(axis=(1, 2)) & np.isfinite(other).all(axis=(1, 2))
    root = np.linalg.cholesky(one[good])
    back = np.linalg.inv(root)
    stretch, axes = np.linalg.eigh(back @ other[good] @ np.swapaxes(back, 1, 2))
    both = root @ axes * np.sqrt(np.maximum(stretch, 1.0))[:, None, :]
    left, size, _ = np.linalg.svd(both)
    length = size[:, 0]
    size[:, 1] = np.maximum(size[:, 1], np.minimum(length, square_m**2 / length))
    size[:, 1] = np.maximum(size[:, 1], length / LONGEST)
    cells[good] = left * size[:, None, :]
    return cells


def limit_resolution(
    cells: Float64[np.ndarray, "n 2 2"], finest_m: float
) -> Float64[np.ndarray, "n 2 2"]:
    """Cells whose sides are no shorter than the finest."""
    sides = np.maximum(np.linalg.norm(cells, axis=1), 1e-9)
    return cells * (np.maximum(sides, finest_m) / sides)[:, None, :]


def smallest_stretch(maps: Float64[np.ndarray, "n 2 2"]) -> PerPoint:
    """The smaller singular value of 2 x 2 matrices: |det| over the larger one."""
    power = (maps**2).sum(axis=(1, 2)) / 2
    area = np.abs(maps[:, 0, 0] * maps[:, 1, 1] - maps[:, 0, 1] * maps[:, 1, 0])
    larger = np.sqrt(power + np.sqrt(np.maximum(power**2 - area**2, 0.0)))
    return area / np.maximum(larger, 1e-12)
