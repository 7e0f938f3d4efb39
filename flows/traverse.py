"""Traverses from the command line: compared, put on the map, written to files, georeferenced.

An uncontrolled mosaic is georeferenced by points of the traverse as Di et al. 2008 do (section 4).
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solmap.config.landing import landing_site
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.runtime.run_record import beside_runs
from solmap.photogrammetry.traverse.differences import Difference, Differences, differences
from solmap.photogrammetry.traverse.georeference import (
    Georeference,
    MapTransform,
    MosaicPoints,
    TrackComparison,
    compare_tracks,
    georeference,
    parse_points,
    simulate_mosaic,
)
from solmap.photogrammetry.traverse.records import Traverse
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.formats.documents.archives import finite
from solmap.products.model import ProductKind
from solmap.products.reports.network_figures import traverse_figure
from solmap.products.store.user_files import read_user_file
from solmap.tasks.mission.imported_traverse import draw_mission_traverse, read_traverses
from solmap.tasks.mission.localisation import traverse_products
from solmap.tasks.mission.publish import publish

FILE_NAMES = {
    ProductKind.PLACES: "{mission}_places.csv",
    ProductKind.SITE_VECTORS: "{mission}_Master.svf",
    ProductKind.ROVER_VECTORS: "{mission}_Site_{site}_Master.rvf",
    ProductKind.TRAVERSE_TABLE: "{mission}_differences.json",
    ProductKind.TRAVERSE_FIGURE: "{mission}_traverse.svg",
    ProductKind.TRAVERSE_FIGURE_PNG: "{mission}_traverse.png",
    ProductKind.TRAVERSE_PACKAGE: "{mission}_traverse.gpkg",
}
"""File names of mission operations as VICAR reads them."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Telemetry against the localised traverse."""

    telemetry: Traverse
    localised: Traverse
    found: Differences
    notes: tuple[str, ...]

    def rows(self, *, every_sol: bool) -> list[dict[str, Any]]:
        """The end, the worst and, if requested, every sol."""
        summary = self.found.summary()
        named = {"end": summary.end, "worst %": summary.worst, "farthest": summary.farthest}
        rows = [_row(where, difference) for where, difference in named.items()]
        sols = self.found.by_sol() if every_sol else ()
        return rows + [_row(f"sol {difference.sol}", difference) for difference in sols]

    @property
    def as_a_whole(self) -> str:
        """One line on a rotation and scale fitted to the whole traverse."""
        fit = georeference(self.telemetry.places_m[:, :2], self.localised.places_m[:, :2])
        return (
            f"{len(self.telemetry)} stops; telemetry drove {self.telemetry.length_m:.1f} m, the "
            f"rover {self.localised.length_m:.1f} m; telemetry fitted to it as a whole: turned by "
            f"{fit.rotation_deg:.2f} degrees, scaled by {fit.scale:.4f}, {fit.sigma_m:.1f} m remain"
        )


def _row(where: str, difference: Difference) -> dict[str, Any]:
    figures = dataclasses.asdict(difference)
    return {"where": where, **{name: finite(value) for name, value in figures.items()}}


def compare_files(
    files: Sequence[Path], mission: str, sols: tuple[int, int], figure: Path | None = None
) -> Comparison:
    """Compare the traverses that files give within (first, last) sol; draw them into `figure`.

    Raises:
        PhotogrammetryError: a file cannot be read, or does not give both traverses.
    """
    landing = landing_site(mission, Settings().landing_sites).landing
    traverses = read_traverses(files, mission, landing)
    telemetry, localised = traverses.at_common_stops(*sols)
    found = differences(telemetry, localised)
    if figure is not None:
        figure.write_bytes(traverse_figure(telemetry, localised, found))
    return Comparison(telemetry, localised, found, traverses.notes)


@beside_runs
def import_files(files: Sequence[Path], mission: str, root: Path) -> str:
    """Publish the traverses in files as layers of a mission; returns one line on them."""
    workspace = open_workspace(root)
    site = landing_site(mission, Settings().landing_sites)
    traverses = read_traverses(files, mission, site.landing)
    layers = draw_mission_traverse(mission, traverses, files, site.landing, workspace.store)
    sols = tuple(sorted({int(sol) for one in traverses.found for sol in one.sols}))
    entry = MissionEntry(mission, site.title, site.landing, None)
    publish.fn(entry, [(ref, sols) for ref in layers], (), (), workspace).check()
    counts = ", ".join(f"{len(one)} {one.solution} stops" for one in traverses.found)
    return f"{mission}: {counts} are on the map"


def export_files(folder: Path, mission: str, root: Path) -> list[Path]:
    """Copy the files of a mission's adjusted traverse into a folder, with operational names."""
    workspace = open_workspace(root)
    made = []
    for ref in traverse_products(mission, workspace.catalogue):
        _, _, site = ref.scope.name.partition("-site")
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / FILE_NAMES[ref.kind].format(mission=mission, site=int(site or 0))
        shutil.copyfile(workspace.store.path(ref), file)
        made.append(file)
    return made


@dataclass(frozen=True, slots=True, eq=False)
class GeoreferencedMosaic:
    """A mosaic on the map, and the differences of its track from the map's."""

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
        """The result in one line, as in the paper."""
        fit, tracks = self.fit, self.tracks
        return (
            f"turned by {fit.rotation_deg:.3f} degrees ({fit.sigma_rotation_deg:.3f}), scaled by "
            f"{fit.scale:.5f} ({fit.sigma_scale:.5f}), {fit.sigma_m:.2f} m a coordinate remain; "
            f"from one start the tracks differ by {tracks.mean_m:.2f} m on average, by "
            f"{tracks.end_m:.2f} m or {tracks.end_percent:.2f} % of the way at the end"
        )

    def document(self) -> dict[str, Any]:
        """The report for programs."""
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


def georeference_mosaic(file: Path, *, affine: bool = False) -> GeoreferencedMosaic:
    """Georeference a mosaic by the points that a file gives.

    Raises:
        TraverseError: the file is broken, or the points do not fix the transform.
    """
    points = parse_points(read_user_file(file).decode("utf-8", "replace"), file.name)
    transform = MapTransform.AFFINITY if affine else MapTransform.SIMILARITY
    fit = georeference(points.mosaic_m, points.map_m, transform)
    return GeoreferencedMosaic(
        points, fit, compare_tracks(fit.apply(points.mosaic_m), points.map_m)
    )


def write_simulated(file: Path, seed: int, rotation_deg: float) -> Path:
    """Write simulated points, and the true answer beside them; returns the path of the answer."""
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
