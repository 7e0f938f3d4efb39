"""The traverse of a whole mission from external files: tables, vector files, location files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solmap.photogrammetry.archive.tables.places import LOCALISED, parse_localisations
from solmap.photogrammetry.archive.tables.vector_files import VectorFile, parse_vector_file
from solmap.photogrammetry.errors import TraverseError
from solmap.photogrammetry.traverse.differences import common_stops, differences
from solmap.photogrammetry.traverse.records import Traverse
from solmap.photogrammetry.traverse.sources import (
    MissionTable,
    parse_mission_table,
    traverse_of_vectors,
)
from solmap.products.crs import LandingPoint, east_north
from solmap.products.formats.vector.geojson import Feature, write_features
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.products.store.user_files import read_user_file
from solmap.tasks.images.files import ContentDigest
from solmap.tasks.scopes import region_scope

TELEMETRY = "telemetry"


@dataclass(frozen=True, slots=True, eq=False)
class MissionTraverses:
    """One traverse from some files, on the landing site's map."""

    found: tuple[Traverse, ...]
    notes: tuple[str, ...]

    def of(self, solution: str) -> Traverse:
        """The traverse of one solution.

        Raises:
            TraverseError: no file contains it.
        """
        for traverse in self.found:
            if traverse.solution == solution:
                return traverse
        known = ", ".join(traverse.solution for traverse in self.found) or "none"
        raise TraverseError(
            f"no file contains a {solution} traverse, only {known}; name one that does"
        )

    def at_common_stops(
        self, first_sol: int = 0, last_sol: int = 1 << 30
    ) -> tuple[Traverse, Traverse]:
        """Telemetry and the localised positions of the stops that both have, within some sols."""
        telemetry, localised = common_stops(self.of(TELEMETRY), self.of(LOCALISED))
        within = np.flatnonzero((localised.sols >= first_sol) & (localised.sols <= last_sol))
        return telemetry.at(within), localised.at(within)


def read_traverses(files: Sequence[Path], mission: str, landing: LandingPoint) -> MissionTraverses:
    """Read traverse tables, vector files, PLACES tables and location files of one mission.

    Raises:
        TraverseError, VectorFileError: a file is of no known kind, or is broken.
        OSError: it cannot be read.
    """
    tables: list[MissionTable] = []
    vectors: list[VectorFile] = []
    places: list[VectorFile] = []
    for file in files:
        text = read_user_file(file).decode("utf-8-sig", "replace")
        if re.match(r"\s*(<\?xml[^>]*>\s*)?<rmc_file", text):
            vectors.append(parse_vector_file(text, file.name))
        elif re.match(r"\s*<|[^\n]*landing_x", text, re.IGNORECASE):
            places.append(
                parse_localisations(text, file.name, mission=mission, keep_without_attitude=True)
            )
        else:
            tables.append(parse_mission_table(text, file.name))
    found = [traverse for table in tables for traverse in _of_table(table, landing)]
    found += [traverse_of_vectors(group) for group in (vectors, places) if group]
    once = {traverse.solution: traverse for traverse in reversed(found)}
    notes = tuple(f"{table.source}: {note}" for table in tables for note in table.notes)
    return MissionTraverses(tuple(once.values()), notes)


def _of_table(table: MissionTable, landing: LandingPoint) -> Iterable[Traverse]:
    """Its localised positions on the map, and telemetry shifted to the same start."""
    start = None
    if table.localised_deg is not None:
        east, north = east_north(landing, table.localised_deg[:, 0], table.localised_deg[:, 1])
        places = np.column_stack([east, north, np.full(len(east), np.nan)])
        start = places[0]
        yield Traverse(LOCALISED, table.stops, table.sols, places)
    if table.telemetry_m is not None:
        telemetry = table.telemetry()
        yield telemetry if start is None else telemetry.starting_at(start)


def draw_mission_traverse(
    mission: str,
    traverses: MissionTraverses,
    sources: Sequence[Path],
    landing: LandingPoint,
    store: ProductStore,
) -> list[ProductRef]:
    """Lines and stops of a mission's traverse as layers, with their differences where known."""
    digests = tuple(ContentDigest.of(read_user_file(file)) for file in sources)
    made = []
    for kind, features in (
        (ProductKind.MISSION_TRAVERSE, traverse_lines),
        (ProductKind.MISSION_STOPS, traverse_stops),
    ):

        def write(path: Path, features: Any = features) -> None:  # noqa: ANN401 - a function
            write_features(path, features(traverses), landing, tags={"mission": mission})

        made.append(store.make(Recipe(kind, region_scope(mission), (), (digests, landing)), write))
    return made


def traverse_lines(traverses: MissionTraverses) -> list[Feature]:
    """A line for every solution."""
    return [
        Feature(
            "LineString",
            _on_map(one),
            {"solution": one.solution, "length_m": round(one.length_m, 1), "stops": len(one)},
            id=one.solution,
        )
        for one in traverses.found
        if len(one) > 1
    ]


def traverse_stops(traverses: MissionTraverses) -> list[Feature]:
    """A point for every stop and solution; localised ones have the difference to telemetry."""
    off = _telemetry_errors(traverses)
    return [
        Feature(
            "Point",
            place[None],
            {
                "stop": stop,
                "sols": [int(sol)],
                "solution": one.solution,
                **(off.get(stop, {}) if one.solution == LOCALISED else {}),
            },
            id=f"{stop}-{one.solution}",
        )
        for one in traverses.found
        for stop, sol, place in zip(one.stops, one.sols, _on_map(one), strict=True)
    ]


def _telemetry_errors(traverses: MissionTraverses) -> dict[str, dict[str, float]]:
    try:
        found = differences(*traverses.at_common_stops())
    except TraverseError:
        return {}
    return {
        stop: {"distance_m": round(float(far), 2), "telemetry_off_m": round(float(off), 2)}
        for stop, far, off in zip(found.stops, found.distance_m, found.horizontal_m, strict=True)
    }


def _on_map(traverse: Traverse) -> np.ndarray:
    """(east, north) and, if all stops have one, the elevation."""
    known = np.isfinite(traverse.places_m[:, 2]).all()
    return traverse.places_m if known else traverse.places_m[:, :2]
