"""Traverses from the command line: compared, put on the map, handed out."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from solmap.config.landing import landing_site
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.photogrammetry.traverse.differences import Difference, Differences, differences
from solmap.photogrammetry.traverse.georeference import georeference
from solmap.photogrammetry.traverse.pictures import traverse_figure
from solmap.photogrammetry.traverse.records import Traverse
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.formats.documents.archives import finite
from solmap.products.model import ProductKind
from solmap.tasks.mission_traverse import draw_mission_traverse, read_traverses
from solmap.tasks.publish import publish
from solmap.tasks.scopes import region_scope

FILE_NAMES = {
    ProductKind.PLACES: "{mission}_places.csv",
    ProductKind.SITE_VECTORS: "{mission}_Master.svf",
    ProductKind.ROVER_VECTORS: "{mission}_Site_{site}_Master.rvf",
    ProductKind.TRAVERSE_TABLE: "{mission}_differences.json",
    ProductKind.TRAVERSE_FIGURE: "{mission}_traverse.svg",
    ProductKind.TRAVERSE_PICTURE: "{mission}_traverse.png",
    ProductKind.TRAVERSE_PACKAGE: "{mission}_traverse.gpkg",
}
"""As mission operations name them (facts 4.3)."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Telemetry against the localised traverse."""

    telemetry: Traverse
    localised: Traverse
    found: Differences
    notes: tuple[str, ...]

    def rows(self, *, every_sol: bool) -> list[dict[str, Any]]:
        """The end, the worst and, if asked for, every sol."""
        summary = self.found.summary()
        named = {"end": summary.end, "worst %": summary.worst, "farthest": summary.farthest}
        rows = [_row(where, difference) for where, difference in named.items()]
        sols = self.found.by_sol() if every_sol else ()
        return rows + [_row(f"sol {difference.sol}", difference) for difference in sols]

    @property
    def as_a_whole(self) -> str:
        """One line on what a turn and a scale of the whole traverse explain."""
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
    telemetry, localised = traverses.compared(*sols)
    found = differences(telemetry, localised)
    if figure is not None:
        figure.write_bytes(traverse_figure(telemetry, localised, found))
    return Comparison(telemetry, localised, found, traverses.notes)


def import_files(files: Sequence[Path], mission: str, root: Path) -> str:
    """Publish the traverses that files give as layers of a mission; one line on what they are."""
    workspace = open_workspace(root)
    site = landing_site(mission, Settings().landing_sites)
    traverses = read_traverses(files, mission, site.landing)
    layers = draw_mission_traverse(mission, traverses, files, site.landing, workspace.store)
    sols = tuple(sorted({int(sol) for one in traverses.found for sol in one.sols}))
    entry = MissionEntry(mission, site.title, site.landing, None)
    publish.fn(entry, [(ref, sols) for ref in layers], (), (), workspace)
    said = ", ".join(f"{len(one)} {one.solution} stops" for one in traverses.found)
    return f"{mission}: {said} are on the map"


def export_files(folder: Path, mission: str, root: Path) -> list[Path]:
    """Copy what tells of a mission's adjusted traverse into a folder, named as operations do."""
    workspace = open_workspace(root)
    made = []
    for kind, name in FILE_NAMES.items():
        for ref in workspace.catalogue.pointers(kind):
            of_mission, _, site = ref.scope.name.partition("-site")
            if of_mission == region_scope(mission).name:
                folder.mkdir(parents=True, exist_ok=True)
                file = folder / name.format(mission=mission, site=int(site or 0))
                shutil.copyfile(workspace.store.path(ref), file)
                made.append(file)
    return made
