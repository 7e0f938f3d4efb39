"""Planar regions held against the truth of their world.

    python -m tests.support.terrain.dip_truth STORE DOWNLINK

takes every planar region that the pairs of every stop see, as they truly looked, reads the true
elevation under each of its samples and fits a plane to those. Regions narrower than `LEAST_M` are
left out: a true terrain of cells of 0.1 m does not resolve them.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.planes import fit_plane
from solmap.photogrammetry.terrain.dtm.ground import trusted_parallax
from solmap.photogrammetry.terrain.dtm.records import TerrainView
from solmap.photogrammetry.terrain.measure.facets import (
    FacetParams,
    ParallaxSamples,
    _points,
    planar_regions,
)
from tests.support.terrain.terrain_truth import Truth, stops_of

LEAST_M = 0.5


def true_normal(points: np.ndarray, truth: Truth) -> np.ndarray:
    """Normal of the plane through the true ground at the places of these points."""
    east, north = points[:, 0], points[:, 1]
    A = np.column_stack([east, north, np.ones(len(east))])
    up = truth.at(east, north).astype(np.float64)
    rise_east, rise_north, _ = np.linalg.lstsq(A, up, rcond=None)[0]
    normal = np.array([-rise_east, -rise_north, 1.0])
    return normal / np.linalg.norm(normal)


def evaluated(view: TerrainView, truth: Truth) -> list[tuple[float, float, float]]:
    """Angle to the truth, what is stated (degrees) and width (metres) of every region."""
    params = FacetParams()
    parallax = trusted_parallax(view, params)
    geometry = view.geometry
    shape = geometry.focal_px, geometry.centre_px
    samples = ParallaxSamples.of(parallax, view.sigma_px, *shape, params.regions)
    rows = []
    for region in planar_regions(samples, params.regions):
        points, covariances = _points(view, samples, region, params)
        try:
            plane = fit_plane(points, covariances)
            true = true_normal(points, truth)
        except (TerrainError, np.linalg.LinAlgError, ValueError):
            continue
        within = points - points.mean(axis=0)
        width = np.sqrt(12 * np.linalg.eigvalsh(within.T @ within / len(points))[1])
        off = true - plane.normal
        rows.append(
            (
                np.degrees(np.linalg.norm(off)),
                np.degrees(np.sqrt(np.trace(plane.covariance))),
                width,
            )
        )
    return rows


def main(store: Path, downlink: Path) -> None:
    truth = Truth.of(downlink)
    rows = np.array(
        [
            row
            for stop in stops_of(store, truth)
            for view in stop.true_views
            for row in evaluated(view, truth)
        ]
    )
    rows = rows[np.isfinite(rows[:, 0]) & (rows[:, 2] >= LEAST_M)]
    angle, stated, _ = rows.T
    shares = [round(float((angle < k * stated).mean()), 2) for k in (1, 2, 3)]
    sys.stdout.write(
        f"{len(rows)} planar regions at least {LEAST_M} m wide\n"
        f"degrees to the truth, 25 50 75 %: {np.percentile(angle, [25, 50, 75]).round(2)}\n"
        f"degrees stated, 50 %: {np.median(stated):.2f}; within 1, 2, 3 of them: {shares}\n"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
