"""Definition of products: kind, scope, recipe, and layer.

A product is a file made once under the digest of its recipe: kind, scope, inputs, parameters and
version of the science. Two runs with the same recipe use the same file, so a rerun finds existing
products. Nothing is edited in place.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from dataclasses import dataclass
from enum import Enum, StrEnum
from functools import cached_property
from typing import Any, Literal, Self

from solmap.products.recipe_names import RECIPE_NAMES, RecipeNames

SCIENCE_VERSION = 12
"""Version of the science: increased when equal inputs and parameters give other products;
CHANGELOG.md lists the changes."""


class ScopeLevel(StrEnum):
    """Subject of a product."""

    IMAGE = "image"
    PAIR = "pair"
    STOP = "stop"
    SOL = "sol"
    REGION = "region"


class ProductKind(StrEnum):
    """Every kind of product: its name, the suffix of its files and its subject.

    The name is the kind's folder in the store and its name in the catalogue.
    """

    suffix: str
    level: ScopeLevel | None
    """Level of its scopes; None: it differs from product to product."""

    def __new__(cls, name: str, suffix: str = "", level: ScopeLevel | None = None) -> Self:
        """A kind; its value is its name."""
        kind = str.__new__(cls, name)
        kind._value_ = name
        kind.suffix, kind.level = suffix, level
        return kind

    IMAGE = "image", ".img", ScopeLevel.IMAGE
    BROWSE = "browse", ".png", ScopeLevel.IMAGE
    VECTORS = "vectors", ".xml", ScopeLevel.REGION
    RADIOMETRY = "radiometry", ".npz", ScopeLevel.REGION
    VERTICAL_PARALLAX = "vertical-parallax", ".json", ScopeLevel.PAIR
    RIG = "rig", ".json", ScopeLevel.SOL
    MATCHES = "matches", ".npz", ScopeLevel.PAIR
    PARALLAX = "parallax", ".npz", ScopeLevel.PAIR
    TIES = "ties", ".npz", ScopeLevel.STOP
    LINKS = "links", ".npz", ScopeLevel.STOP
    MANUAL_TIES = "hand-ties", ".txt", ScopeLevel.REGION
    NETWORK = "network", ".json", ScopeLevel.SOL
    MARGINALISED_STOP = "settled", ".json", ScopeLevel.STOP
    ORIENTATIONS = "orientations", ".json", ScopeLevel.SOL
    QUALITY = "quality", ".json", ScopeLevel.SOL
    REPORT = "report", ".html", ScopeLevel.SOL
    DTM = "dtm", ".tif"
    ORTHOPHOTO = "orthophoto", ".tif"
    SOURCES = "sources", ".tif"
    COLOUR = "colour", ".tif"
    SLOPE = "slope", ".tif"
    ASPECT = "aspect", ".tif"
    HILLSHADE = "hillshade", ".tif"
    NORTHERLY_TILT = "northerly-tilt", ".tif"
    ROUGHNESS = "roughness", ".tif"
    INSOLATION = "insolation", ".tif"
    HAVENS = "havens", ".geojson"
    VIEWSHED = "viewshed", ".tif"
    HAZARD = "hazard", ".tif"
    CONTOURS = "contours", ".geojson"
    MODEL = "model", ".glb"
    VIEW_MODEL = "view-model", ".glb"
    TILESET = "tileset", ".3tz"
    DIPS = "dips", ".geojson"
    POINTS = "points", ".ply"
    POINT_TILES = "point-tiles", ".3tz"
    PANORAMA = "panorama", ".tif"
    PANORAMA_GROUND = "panorama-ground", ".tif", ScopeLevel.STOP
    FAR_DTM = "far-dtm", ".tif"
    FAR_HILLSHADE = "far-hillshade", ".tif"
    FAR_CONTOURS = "far-contours", ".geojson"
    REGION_DTM = "region-dtm", ".tif"
    REGION_ORTHOPHOTO = "region-orthophoto", ".tif"
    REGION_SEAMS = "region-seams", ".tif"
    REGION_HILLSHADE = "region-hillshade", ".tif"
    REGION_SLOPE = "region-slope", ".tif"
    REGION_ASPECT = "region-aspect", ".tif"
    REGION_NORTHERLY_TILT = "region-northerly-tilt", ".tif"
    REGION_ROUGHNESS = "region-roughness", ".tif"
    REGION_INSOLATION = "region-insolation", ".tif"
    REGION_HAVENS = "region-havens", ".geojson"
    REGION_HAZARD = "region-hazard", ".tif"
    REGION_CONTOURS = "region-contours", ".geojson"
    TRAVERSE = "traverse", ".geojson"
    TRAVERSE_TABLE = "traverse-table", ".json", ScopeLevel.REGION
    TRAVERSE_FIGURE = "traverse-figure", ".svg", ScopeLevel.REGION
    TRAVERSE_FIGURE_PNG = "traverse-picture", ".png", ScopeLevel.REGION
    TRAVERSE_PACKAGE = "traverse-package", ".gpkg", ScopeLevel.REGION
    PLACES = "places", ".csv", ScopeLevel.REGION
    SITE_VECTORS = "site-vectors", ".svf", ScopeLevel.REGION
    ROVER_VECTORS = "rover-vectors", ".rvf", ScopeLevel.REGION
    MISSION_TRAVERSE = "mission-traverse", ".geojson"
    MISSION_STOPS = "mission-stops", ".geojson"
    ORBITAL_IMAGE = "orbital-image", ".tif", ScopeLevel.REGION
    ORBITAL_REGISTRATION = "orbital-registration", ".json", ScopeLevel.REGION
    ORBITAL = "orbital", ".tif"
    CONTROL_FILE = "control-file", ".txt", ScopeLevel.REGION
    CONTROL = "control", ".json", ScopeLevel.REGION
    STOPS = "stops", ".geojson"
    FOOTPRINTS = "footprints", ".geojson"
    POINTING = "pointing", ".geojson"
    TIE_POINTS = "tie-points", ".geojson"
    QUICKLOOK = "quicklook", ".png"


_UNTIED = re.compile(r"(.+)-ORIGIN(\d+)(?:-(\d+))?")


def untied_map(mission: str, site: int, drive: int | None = None) -> str:
    """Name of the map of stops that are not tied to the lander: `MER2-ORIGIN137`.

    Its origin is a site, or the rover at one stop: `MER2-ORIGIN10-64`. The map of sites tied to the
    lander has the name of the mission.
    """
    return f"{mission}-ORIGIN{site}" + ("" if drive is None else f"-{drive}")


def mission_of(map_name: str) -> str:
    """The mission of a map."""
    found = _UNTIED.fullmatch(map_name)
    return found[1] if found else map_name


def origin_of(map_name: str) -> tuple[int, ...]:
    """(site,) or (site, drive) of the origin of an untied map; empty for a mission's map."""
    found = _UNTIED.fullmatch(map_name)
    return tuple(int(number) for number in found.groups()[1:] if number) if found else ()


def _variants(prefix: str) -> dict[ProductKind, ProductKind]:
    """Kinds that also exist with a prefix, and the kinds with the prefix."""
    names = set(ProductKind)
    return {
        kind: ProductKind(f"{prefix}{kind}") for kind in ProductKind if f"{prefix}{kind}" in names
    }


FAR_KINDS = _variants("far-")
"""Kinds of a stop's map, and of its map of far ground, which are separate layers."""
REGION_KINDS = _variants("region-")
"""Kinds of maps of all stops of a mission together."""
_VARIANTS = {ProductKind.FAR_DTM: FAR_KINDS, ProductKind.REGION_DTM: REGION_KINDS}
"""Kinds of maps by the kind of the terrain model that they are made from."""


@dataclass(frozen=True, slots=True, order=True)
class Scope:
    """Subject of a product: one image, pair, stop or sol, or the whole region of a mission.

    `name` is lower case and safe in paths and URLs: `mer2-site0010-drive0064`, `mer2-sol0156`,
    `mer2` for the region.
    """

    level: ScopeLevel
    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True, order=True)
class ProductRef:
    """A reference of a few bytes to a product; the store resolves it to a path."""

    kind: ProductKind
    scope: Scope
    digest: str
    """Hexadecimal digest of the recipe, 16 digits."""

    def map_kind(self, kind: ProductKind) -> ProductKind:
        """The kind of a map made from a terrain model: of a stop, of far ground, of a region."""
        return _VARIANTS[self.kind][kind] if self.kind in _VARIANTS else kind

    @property
    def text(self) -> str:
        """The reference in one line, for documents; the inverse is `of_text`."""
        return f"{self.kind}/{self.scope.level}/{self.scope.name}/{self.digest}"

    @classmethod
    def of_text(cls, text: str) -> ProductRef:
        """The inverse of `text`."""
        kind, level, scope, digest = text.split("/")
        return cls(ProductKind(kind), Scope(ScopeLevel(level), scope), digest)

    def readable_name(
        self, map_name: str, sols: tuple[int, ...] = (), cell_m: float | None = None
    ) -> str:
        """Name for a file outside the store, without suffix.

        Args:
            map_name: The mission, or the untied map, of the product.
            sols: Its sols, ascending; of several the first and last are named.
            cell_m: Size of its cells.
        """
        place = _PLACE.sub(_short_place, _place_of(self.scope, map_name)).replace("-", "_")
        kind = self.kind.removeprefix("region-") if "region" in place else str(self.kind)
        when = "-".join(f"{sol:04d}" for sol in _ends(sols))
        parts = (map_name, f"sol{when}" if when else "", place, kind, _size(cell_m))
        return "_".join(part for part in parts if part)

    @property
    def file_name(self) -> str:
        """The file's path below the folder of products."""
        return f"{self.kind}/{self.scope.name}/{self.digest}{self.kind.suffix}"


@dataclass(frozen=True)
class Recipe:
    """Everything that determines a product."""

    kind: ProductKind
    scope: Scope
    inputs: tuple[ProductRef, ...] = ()
    params: Any = None
    """A frozen dataclass, or a tuple of them."""
    science: int = SCIENCE_VERSION

    @cached_property
    def document(self) -> dict[str, Any]:
        """The recipe as plain JSON values."""
        return {
            "kind": str(self.kind),
            "scope": {"level": str(self.scope.level), "name": self.scope.name},
            "inputs": [f"{ref.kind}/{ref.scope.name}/{ref.digest}" for ref in self.inputs],
            "params": plain(self.params),
            "science": self.science,
        }

    @cached_property
    def ref(self) -> ProductRef:
        """The reference of this recipe's product."""
        text = json.dumps(self.document, sort_keys=True, separators=(",", ":"))
        return ProductRef(self.kind, self.scope, hashlib.sha256(text.encode()).hexdigest()[:16])


def plain(value: Any) -> Any:  # noqa: ANN401 - any parameter record
    """Dataclasses, enumerations and tuples as plain JSON values, class names kept."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        class_name = type(value).__name__
        names = RECIPE_NAMES.get(class_name, RecipeNames())
        fields = {
            names.fields.get(f.name, f.name): plain(getattr(value, f.name))
            for f in dataclasses.fields(value)
        }
        return {"": names.name or class_name, **fields, **names.constants}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        items = [plain(item) for item in value]
        return sorted(items) if isinstance(value, set | frozenset) else items
    return value


@dataclass(frozen=True, slots=True)
class Layer:
    """A published product for the map and its users.

    Bounds are (west, south, east, north) in metres of the mission's local map; for rasters the
    range of values is that of the first band, for stretch and legend.
    """

    ref: ProductRef
    mission: str
    title: str
    type: Literal["raster", "vector", "model", "panorama"]
    """Models and panoramas are not on the map; they have other viewers."""
    bounds: tuple[float, float, float, float]
    cell_m: float | None
    unit: str | None
    range: tuple[float, float] | None
    sols: tuple[int, ...]
    made_at: str
    """UTC, ISO 8601."""

    @property
    def id(self) -> str:
        """Stable name of the layer, without the digest: scope and kind."""
        return f"{self.ref.scope.name}/{self.ref.kind}"

    @property
    def readable_name(self) -> str:
        """Name for files, without suffix: `MER2_sol0156_site010_drive0100_dtm_4cm`."""
        return self.ref.readable_name(self.mission, self.sols, self.cell_m)

    @property
    def full_title(self) -> str:
        """Complete title: `Elevation, sol 156, site 10 drive 100, 4 cm`."""
        place = _PLACE.sub(_place_text, _place_of(self.ref.scope, self.mission))
        cell = re.sub(r"(\d)([a-z])", r"\1 \2", _size(self.cell_m))
        sols = "-".join(str(sol) for sol in _ends(self.sols))
        origin = " ".join(
            f"{what} {number}"
            for what, number in zip(("site", "drive"), origin_of(self.mission), strict=False)
        )
        untied = f"origin: {origin}, not tied to the lander" if origin else ""
        parts = (self.title, f"sol {sols}" if sols else "", place.replace("-", " "), cell, untied)
        return ", ".join(part for part in parts if part)


def _ends(sols: tuple[int, ...]) -> tuple[int, ...]:
    """The first and the last of some sols; the only one, once."""
    return tuple(dict.fromkeys((*sols[:1], *sols[-1:])))


def _place_of(scope: Scope, map_name: str) -> str:
    """The name of a scope without that of its map or mission."""
    for prefix in (map_name.lower(), mission_of(map_name).lower()):
        if scope.name == prefix or scope.name.startswith(f"{prefix}-"):
            return scope.name.removeprefix(prefix).removeprefix("-")
    return scope.name


def _size(cell_m: float | None) -> str:
    """Size of a cell in whole metres, centimetres or, rounded, millimetres; empty if none."""
    if not cell_m:
        return ""
    for unit, metres in (("m", 1.0), ("cm", 0.01)):
        if abs(cell_m / metres - round(cell_m / metres)) < _WHOLE:
            return f"{round(cell_m / metres)}{unit}"
    return f"{cell_m * 1000:.3g}mm"


_PLACE = re.compile(r"\b(site|drive)(\d+)")
_DIGITS = {"site": 3, "drive": 4}
_WHOLE = 1e-6
"""Tolerance, in units, for a size to count as a whole number."""


def _short_place(found: re.Match[str]) -> str:
    return f"{found[1]}{int(found[2]):0{_DIGITS[found[1]]}d}"


def _place_text(found: re.Match[str]) -> str:
    return f"{found[1]} {int(found[2])}"
