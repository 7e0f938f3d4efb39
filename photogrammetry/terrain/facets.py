"""Planar facets of rocks and outcrops: where they are, how large, and their strike and dip.

The planar regions of a pair's parallax (`planar_regions`) become points in metres, each with the
covariance of its own match; neighbours that share their error count together as one. Through
them goes the likeliest plane (`plane_fit`). What the pair's pointing and the stop's tilt are unsure
of turns all facets of a pair together and is part of every facet's covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solmap.photogrammetry.arrays import Covariances3, Mask, ObjectPoints
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.attitude import Attitude, attitude
from solmap.photogrammetry.terrain.dtm.ground import (
    MAP_FROM_LSL,
    SightParams,
    camera_on_map,
    map_from_pair_rotation,
    trusted_parallax,
)
from solmap.photogrammetry.terrain.dtm.records import TerrainView
from solmap.photogrammetry.terrain.planar_regions import (
    ParallaxSamples,
    RegionParams,
    planar_regions,
)
from solmap.photogrammetry.terrain.plane_fit import SHARED_PX, PlaneFit, fit_plane


@dataclass(frozen=True, slots=True)
class FacetParams(SightParams):
    """How to find planar facets."""

    max_relative_sigma: float = 0.01
    """Largest standard deviation along the view over the distance: 10 m with Navcam, 43 m with
    Pancam; beyond it a bed is thinner than the noise."""
    regions: RegionParams = field(default_factory=RegionParams)
    min_dip_deg: float = 10.0
    """Facets that dip less are taken for the ground that the rocks stand on."""
    max_sigma_deg: float = 10.0
    """Largest standard deviation of strike and dip: the aim of a geologist's compass is 2 degrees,
    and beyond 10 one bed cannot be told from the next."""
    shared_px: float = SHARED_PX
    """Pixels this close share their error."""
    sigma_image_px: float = 0.25
    """Standard deviation of an image coordinate: half a pixel's rounding by the matching window."""


@dataclass(frozen=True, slots=True, eq=False)
class Facet:
    """A planar piece of rock as one pair sees it."""

    pair_id: str
    plane: PlaneFit
    attitude: Attitude
    length_m: float
    """Longest extent within the plane, as that of an even spread: sqrt(12) standard deviations."""
    width_m: float
    """Extent across the longest one."""
    distance_m: float
    """From the camera."""


def find_facets(view: TerrainView, params: FacetParams) -> list[Facet]:
    """The planar facets that a view shows, flattest first.

    Level ground, and facets whose strike or dip cannot be told well enough, are left out.
    """
    geometry = view.geometry
    samples = ParallaxSamples.of(
        trusted_parallax(view, params), geometry.focal_px, geometry.centre_px, params.regions
    )
    found = []
    for region in planar_regions(samples, params.regions):
        try:
            facet = _facet(view, samples, region, params)
        except TerrainError:  # a line of points, or level: there is no strike to report
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
    """A region's samples on the map, and the covariance of each as if it were on its own."""
    row, col = np.nonzero(region)
    left = np.column_stack([samples.col[col], samples.row[row]])
    parallax = samples.parallax[row, col].astype(np.float64)
    geometry, rotation = view.geometry, map_from_pair_rotation(view.lsl_from_pair)
    at = samples.row[row].astype(int), samples.col[col].astype(int)
    sigma_px = np.full(len(row), params.sigma_parallax_px)
    if view.sigma_px is not None:
        sigma_px = view.sigma_px[at].astype(np.float64)
    unit = geometry.covariances(left, parallax, params.sigma_image_px, 1.0)
    across = geometry.covariances(left, parallax, params.sigma_image_px, 0.0)
    covariances = across + (unit - across) * (sigma_px**2)[:, None, None]
    shared = max(1.0, (params.shared_px / params.regions.step_px) ** 2)
    points = geometry.triangulate(left, parallax) @ rotation.T + camera_on_map(view.lsl_from_pair)
    return points, shared * (rotation @ covariances @ rotation.T)
