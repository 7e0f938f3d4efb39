"""Planar facets of rocks and outcrops: position, size, strike and dip.

Facets are planar regions of a parallax map, grown from its flattest samples.

In an epipolar image every plane n.P = d is linear in parallax (x, y from the principal point),

    p = a + b x + c y,      n  ~  (b, c, a / f)      in (right, down, forward)

so planar pieces are found in the image itself. Around every sample of the image a plane of parallax
is fitted over a window; where the parallax deviates from it by no more than noise, the sample may
start a region. Starting with the flattest, a region takes the connected samples whose parallax is
on its plane and whose own plane has the same orientation within an angle, or within the effect of
noise over the window. Its plane is fitted to them again, until the region stops growing. A region
that bends by more than noise explains, grown within two standard deviations of its samples and
within the tolerance for all, is rejected.

A region's samples become points in metres, each with the covariance of its own match, and the most
likely plane is fitted to them (`planes.fit_plane`). Errors of neighbours are correlated, by
exp(-d / L) at a distance d of the image. The plane's slope along x then has

    sum_ij x_i x_j exp(-d_ij / L) / sum_i x_i^2

times the variance that independent errors would give it (x from the region's middle); the points'
covariances are multiplied by the larger one of the factors along x and y.
Errors of the pair's pointing and the stop's tilt rotate all facets of a pair together and are part
of every facet's covariance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from solmap.photogrammetry.arrays import (
    Bool,
    Covariances3,
    Float32,
    Float64,
    Mask,
    ObjectPoints,
    ParallaxMap,
    PerPoint,
)
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.matching.parallax_planes import whole_window_planes
from solmap.photogrammetry.planes import PlaneFit, fit_plane, least_squares_plane
from solmap.photogrammetry.ranges import (
    Count,
    Degrees,
    Elevation,
    OddPixels,
    Pixels,
    ShareAboveZero,
    Slope,
    WholePixels,
)
from solmap.photogrammetry.terrain.dtm.ground import (
    MAP_FROM_LSL,
    SightParams,
    camera_on_map,
    map_from_pair_rotation,
    trusted_parallax,
)
from solmap.photogrammetry.terrain.dtm.records import TerrainView
from solmap.photogrammetry.terrain.measure.strike_dip import Attitude, attitude

Coefficients = Float64[np.ndarray, " 3"]
"""(a, b, c) of the parallax a + b x + c y, pixels from the principal point."""
FLAT_PX = 0.2
"""Largest root mean square over the window of a sample that starts a region: noise only."""
BOW_PX = 0.05
"""Largest root mean square bending of a region: noise hardly bends so many samples."""
SIGMA_IMAGE_PX = 0.25
"""Standard deviation of an image coordinate: half a pixel's rounding by the matching window."""
MOST = 500
"""Most regions of one image; more are pebbles."""
CORRELATED = 4.0
"""Correlation distances beyond which errors count as independent."""
FIRST_REACH = 16
"""Half side of the first window around the seed, in samples."""
GROWTHS = 20
"""Most rounds of growing and fitting a region; usually four are enough."""


@dataclass(frozen=True, slots=True)
class PlanarRegionParams:
    """How to find planar regions."""

    window_px: OddPixels = 17
    """Side of the window to which a sample's own plane is fitted: two matching windows."""
    step_px: WholePixels = 4
    """Distance of the samples: half of the matching window."""
    tolerance_px: Pixels = 0.2
    """Largest distance of parallaxes from their region's plane; two standard deviations where these
    are more."""
    turn_deg: Degrees = 15.0
    """Angle between a sample's own plane and its region's that is always accepted."""
    min_samples: Count = 60
    """Smallest region: with a sample every 4 pixels, 30 by 30 pixels."""

    def __post_init__(self) -> None:
        if self.window_px % 2 == 0 or self.window_px < 3 or self.step_px < 1:  # noqa: PLR2004
            raise TerrainError(
                "window_px must be odd and at least 3 and step_px at least 1, not "
                f"{self.window_px} and {self.step_px}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ParallaxSamples:
    """Every n-th pixel of a view: parallax, and the plane of parallax around."""

    row: Float64[np.ndarray, " rows"]
    """Line of every sample in the image."""
    col: Float64[np.ndarray, " cols"]
    parallax: ParallaxMap
    own: Float32[np.ndarray, "3 rows cols"]
    """(a, b, c) of the plane around; NaN where there is none."""
    rms_px: ParallaxMap
    tolerance_px: ParallaxMap
    """Largest distance from a region's plane."""
    focal_px: float
    centre_px: tuple[float, float]

    @classmethod
    def of(
        cls,
        parallax: ParallaxMap,
        sigma_px: ParallaxMap | None,
        focal_px: float,
        centre_px: tuple[float, float],
        params: PlanarRegionParams,
    ) -> ParallaxSamples:
        """Samples of a parallax map, NaN where it is not trusted, and its standard deviation."""
        own, rms_px = whole_window_planes(parallax, params.window_px)
        pick = (slice(params.step_px // 2, None, params.step_px),) * 2
        row, col = (np.arange(n, dtype=np.float64)[pick[0]] for n in parallax.shape)
        a, b, c = (one[pick] for one in own)
        a = a - b * (col - centre_px[0])[None, :] - c * (row - centre_px[1])[:, None]
        planes = np.stack([a, b, c]).astype(np.float32)
        tolerance_px = np.full_like(parallax[pick], params.tolerance_px)
        if sigma_px is not None:
            tolerance_px = np.maximum(tolerance_px, 2 * sigma_px[pick])
        samples = parallax[pick], planes, rms_px[pick], tolerance_px
        return cls(row, col, *samples, focal_px, centre_px)

    def part(self, rows: slice, cols: slice) -> ParallaxSamples:
        """The samples of a window."""
        return replace(
            self,
            row=self.row[rows],
            col=self.col[cols],
            parallax=self.parallax[rows, cols],
            own=self.own[:, rows, cols],
            rms_px=self.rms_px[rows, cols],
            tolerance_px=self.tolerance_px[rows, cols],
        )

    def off(self, plane: Coefficients) -> ParallaxMap:
        """Distance of every sample's parallax from a plane."""
        a, b, c = plane
        x, y = self.col - self.centre_px[0], self.row - self.centre_px[1]
        return np.abs(self.parallax - (a + b * x[None, :] + c * y[:, None])).astype(np.float32)

    def facing(self, plane: Coefficients, params: PlanarRegionParams) -> Mask:
        """Whether every sample's own plane has a plane's orientation, within its uncertainty."""
        scale = np.array([1 / self.focal_px, 1.0, 1.0])
        n = plane * scale
        own = self.own * scale[:, None, None]
        cosine = np.einsum("i,irc->rc", n / np.linalg.norm(n), own) / np.linalg.norm(own, axis=0)
        tilt = np.abs(self.own[1:] - plane[1:, None, None]).max(axis=0) * (params.window_px / 2)
        return (cosine >= np.cos(np.radians(params.turn_deg))) | (tilt <= self.tolerance_px)

    def fit(self, region: Mask) -> Coefficients:
        """The plane of parallax through the samples of a region."""
        x, y, p = self._of(region)
        return least_squares_plane(x, y, p)

    def bow(self, region: Mask) -> float:
        """Root mean square bending of a region: a second-degree surface minus the plane."""
        x, y, p = self._of(region)
        x, y = (one - one.mean() for one in (x, y))
        A = np.column_stack([np.ones(len(p)), x, y])
        B = np.column_stack([A, x * x, x * y, y * y])
        bent, flat = (one @ np.linalg.lstsq(one, p, rcond=None)[0] for one in (B, A))
        return float(np.sqrt(np.mean((bent - flat) ** 2)))

    def _of(self, region: Mask) -> tuple[PerPoint, PerPoint, PerPoint]:
        """(x, y) from the principal point, and parallax, of a region's samples."""
        row, col = np.nonzero(region)
        x, y = self.col[col] - self.centre_px[0], self.row[row] - self.centre_px[1]
        return x, y, self.parallax[row, col].astype(np.float64)


def planar_regions(samples: ParallaxSamples, params: PlanarRegionParams) -> Iterator[Mask]:
    """Connected samples of one plane each, the flattest first, without overlaps."""
    free = np.isfinite(samples.rms_px)
    seeds = np.where(free & (samples.rms_px <= FLAT_PX), samples.rms_px, np.inf)
    narrow = np.full_like(samples.tolerance_px, params.tolerance_px)
    for _ in range(MOST):
        seed = np.unravel_index(np.argmin(seeds), seeds.shape)
        if not np.isfinite(seeds[seed]):
            return
        for tolerated in (samples, replace(samples, tolerance_px=narrow)):
            region = _grow(tolerated, free, (int(seed[0]), int(seed[1])), params)
            flat = region.sum() >= params.min_samples and samples.bow(region) <= BOW_PX
            if flat:
                break
        seeds[seed] = np.inf
        seeds[region] = np.inf
        if flat:
            free &= ~region
            yield region


def _grow(
    samples: ParallaxSamples,
    free: Bool[np.ndarray, "rows cols"],
    seed: tuple[int, int],
    params: PlanarRegionParams,
) -> Mask:
    """The free samples connected with the seed on one plane.

    They are searched in a window around the seed that widens while they reach its border.
    """
    plane = samples.own[:, seed[0], seed[1]].astype(np.float64)
    region = np.zeros(free.shape, np.bool_)
    reach = FIRST_REACH
    for _ in range(GROWTHS):
        window = tuple(slice(max(0, at - reach), at + reach + 1) for at in seed)
        grown = np.zeros_like(region)
        grown[window] = _on_plane(samples.part(*window), free[window], plane, seed, reach, params)
        if grown.sum() <= region.sum():
            return region
        region = grown
        plane = samples.fit(region)
        row, col = np.nonzero(region)
        if max(np.abs(row - seed[0]).max(), np.abs(col - seed[1]).max()) >= reach:
            reach *= 2
    return region


def _on_plane(
    samples: ParallaxSamples,
    free: Bool[np.ndarray, "rows cols"],
    plane: Coefficients,
    seed: tuple[int, int],
    reach: int,
    params: PlanarRegionParams,
) -> Mask:
    """Free samples of a window on a plane that are connected with the seed."""
    at = min(seed[0], reach), min(seed[1], reach)
    on = free & (samples.off(plane) <= samples.tolerance_px) & samples.facing(plane, params)
    if not on[at]:
        return np.zeros_like(on)
    _, labels = cv2.connectedComponents(on.astype(np.uint8), connectivity=4)
    return labels == labels[at]


@dataclass(frozen=True, slots=True)
class FacetParams(SightParams):
    """How to find planar facets."""

    max_relative_sigma: ShareAboveZero = 0.01
    """Largest standard deviation along the view over the distance: 10 m with Navcam, 43 m with
    Pancam; beyond it beds are thinner than the noise."""
    regions: PlanarRegionParams = field(default_factory=PlanarRegionParams)
    min_dip_deg: Elevation = 10.0
    """Facets that dip less count as the ground around rocks."""
    max_sigma_deg: Slope = 10.0
    """Largest standard deviation of strike and dip: the aim of a geologist's compass is 2 degrees,
    and beyond 10 beds cannot be distinguished."""
    correlation_px: Pixels = 10.0
    """Distance over which the correlation of parallaxes' errors falls to 1/e."""


@dataclass(frozen=True, slots=True, eq=False)
class Facet:
    """A planar piece of rock from one pair."""

    pair_id: str
    plane: PlaneFit
    attitude: Attitude
    length_m: float
    """Longest extent within the plane, for an even distribution: sqrt(12) standard deviations."""
    width_m: float
    """Extent across the longest one."""
    distance_m: float
    """Distance from the camera."""


def find_facets(view: TerrainView, params: FacetParams) -> list[Facet]:
    """The planar facets of a view, flattest first.

    Level ground, and facets whose strike or dip is too uncertain, are left out.
    """
    geometry = view.geometry
    shape = geometry.focal_px, geometry.centre_px
    parallax = trusted_parallax(view, params)
    samples = ParallaxSamples.of(parallax, view.sigma_px, *shape, params.regions)
    found = []
    for region in planar_regions(samples, params.regions):
        try:
            facet = _facet(view, samples, region, params)
        except TerrainError:  # points on a line, or level: there is no strike to report
            continue
        if _is_reported(facet.attitude, params):
            found.append(facet)
    return found


def _is_reported(found: Attitude, params: FacetParams) -> bool:
    largest = np.radians(params.max_sigma_deg)
    steep = found.dip >= np.radians(params.min_dip_deg)
    return bool(steep and max(found.sigma_strike, found.sigma_dip) <= largest)


def _facet(view: TerrainView, samples: ParallaxSamples, region: Mask, params: FacetParams) -> Facet:
    points, covariances = _points(view, samples, region, params)
    turning = None
    if view.covariance is not None:
        turning = MAP_FROM_LSL @ view.covariance[:3, :3] @ MAP_FROM_LSL.T
    plane = fit_plane(points, covariances, turning)
    within = points - plane.centre
    spread = np.linalg.eigvalsh(within.T @ within / len(points))
    width, length = np.sqrt(12 * np.maximum(spread[1:], 0))
    distance = np.linalg.norm(plane.centre - camera_on_map(view.lsl_from_pair))
    return Facet(view.pair_id, plane, attitude(plane), float(length), float(width), float(distance))


def _points(
    view: TerrainView, samples: ParallaxSamples, region: Mask, params: FacetParams
) -> tuple[ObjectPoints, Covariances3]:
    """A region's samples on the map, and the independent covariance of each."""
    row, col = np.nonzero(region)
    left = np.column_stack([samples.col[col], samples.row[row]])
    parallax = samples.parallax[row, col].astype(np.float64)
    geometry, rotation = view.geometry, map_from_pair_rotation(view.lsl_from_pair)
    at = samples.row[row].astype(int), samples.col[col].astype(int)
    sigma_px = np.full(len(row), params.sigma_parallax_px)
    if view.sigma_px is not None:
        sigma_px = view.sigma_px[at].astype(np.float64)
    unit = geometry.covariances(left, parallax, SIGMA_IMAGE_PX, 1.0)
    across = geometry.covariances(left, parallax, SIGMA_IMAGE_PX, 0.0)
    covariances = across + (unit - across) * (sigma_px**2)[:, None, None]
    points = geometry.triangulate(left, parallax) @ rotation.T + camera_on_map(view.lsl_from_pair)
    factor = variance_factor(region, params.correlation_px / params.regions.step_px)
    return points, factor * (rotation @ covariances @ rotation.T)


def variance_factor(region: Mask, correlation: float) -> float:
    """Variance of a region's slope over that of independent samples; at least 1.

    Args:
        region: The samples, at unit distances.
        correlation: Distance over which the correlation of their errors falls to 1/e, in samples.
    """
    reach = int(np.ceil(CORRELATED * correlation))
    offset = np.arange(-reach, reach + 1)
    correlations = np.exp(-np.hypot(offset[:, None], offset[None, :]) / correlation)
    factors = [1.0]
    for along in np.nonzero(region):
        x = np.zeros(region.shape)
        x[region] = along - along.mean()
        common = cv2.filter2D(x, -1, correlations, borderType=cv2.BORDER_CONSTANT)
        factors.append(float((x * common).sum() / max(float((x * x).sum()), 1e-9)))
    return max(factors)
