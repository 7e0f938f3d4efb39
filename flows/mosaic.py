"""An uncontrolled mosaic from the command line: hung on a track, as Di et al. 2008 (section 4)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solmap.photogrammetry.traverse.georeference import (
    Georeference,
    MapTransform,
    TrackComparison,
    compare_tracks,
    georeference,
)
from solmap.photogrammetry.traverse.mosaics import MosaicPoints, parse_points, simulate_mosaic
from solmap.products.formats.documents.archives import finite


@dataclass(frozen=True, slots=True, eq=False)
class HungMosaic:
    """A mosaic on the map, and how its track differs from the map's."""

    points: MosaicPoints
    fit: Georeference
    tracks: TrackComparison

    def rows(self) -> list[dict[str, Any]]:
        """A row for every point, metres."""
        both = zip(self.points.names, self.fit.residuals_m, self.tracks.differences_m, strict=True)
        return [
            {
                "point": name,
                "residual_east_m": round(float(residual[0]), 3),
                "residual_north_m": round(float(residual[1]), 3),
                "difference_m": round(float(difference), 3),
            }
            for name, residual, difference in both
        ]

    @property
    def summary(self) -> str:
        """What the paper reports, in one line."""
        fit, tracks = self.fit, self.tracks
        return (
            f"turned by {fit.rotation_deg:.3f} degrees ({fit.sigma_rotation_deg:.3f}), scaled by "
            f"{fit.scale:.5f} ({fit.sigma_scale:.5f}), {fit.sigma_m:.2f} m a coordinate remain; "
            f"from one start the tracks differ by {tracks.mean_m:.2f} m on average, by "
            f"{tracks.end_m:.2f} m or {tracks.end_percent:.2f} % of the way at the end"
        )

    def document(self) -> dict[str, Any]:
        """The same for programs."""
        fit, tracks = self.fit, self.tracks
        return {
            "transform": str(fit.transform),
            "rotation_deg": fit.rotation_deg,
            "sigma_rotation_deg": finite(fit.sigma_rotation_deg),
            "scale": fit.scale,
            "sigma_scale": finite(fit.sigma_scale),
            "sigma_m": finite(fit.sigma_m),
            "mean_m": tracks.mean_m,
            "end_m": tracks.end_m,
            "end_percent": finite(tracks.end_percent),
            "points": self.rows(),
        }


def hang_mosaic(file: Path, *, affine: bool = False) -> HungMosaic:
    """Georeference a mosaic by the points that a file gives.

    Raises:
        TraverseError: the file is broken, or the points do not fix the transform.
    """
    points = parse_points(file.read_text(encoding="utf-8"), file.name)
    transform = MapTransform.AFFINITY if affine else MapTransform.SIMILARITY
    fit = georeference(points.mosaic_m, points.map_m, transform)
    return HungMosaic(points, fit, compare_tracks(fit.apply(points.mosaic_m), points.map_m))


def write_simulated(file: Path, seed: int, rotation_deg: float) -> Path:
    """Write simulated points, and beside them the answer; the path of the answer."""
    made = simulate_mosaic(np.random.default_rng(seed), rotation_deg=rotation_deg)
    file.write_text(made.points.table(), encoding="utf-8")
    truth = file.with_suffix(".truth.json")
    document = {
        "rotation_deg": made.rotation_deg,
        "scale": made.scale,
        "residuals_m": np.round(made.residuals_m, 4).tolist(),
        "differences_m": np.round(made.differences_m, 4).tolist(),
        "end_percent": made.end_percent,
    }
    truth.write_text(json.dumps(document, indent=1), encoding="utf-8")
    return truth
