"""What a product is: its kind, what it is about, the recipe it was made by, and its layer.

A product is a file made once under the digest of its recipe: kind, scope, inputs, parameters and
version of the science. Two runs with the same recipe ask for the same file, so a rerun looks up
what is there. Nothing is edited in place.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from enum import Enum, StrEnum
from functools import cached_property
from typing import Any, Literal

from solmap.products.recipe_names import RECIPE_NAMES, RecipeNames

SCIENCE_VERSION = 3
"""Raised when equal inputs and parameters give other products; CHANGELOG.md says what changed."""


class ProductKind(StrEnum):
    """Every kind of product; the value is its folder and its name in the catalogue."""

    IMAGE = "image"
    BROWSE = "browse"
    VECTORS = "vectors"
    RADIOMETRY = "radiometry"
    MATCHES = "matches"
    PARALLAX = "parallax"
    TIES = "ties"
    LINKS = "links"
    MANUAL_TIES = "hand-ties"
    NETWORK = "network"
    MARGINALISED_STOP = "settled"
    ORIENTATIONS = "orientations"
    QUALITY = "quality"
    REPORT = "report"
    DTM = "dtm"
    ORTHOPHOTO = "orthophoto"
    SOURCES = "sources"
    COLOUR = "colour"
    SLOPE = "slope"
    ASPECT = "aspect"
    HILLSHADE = "hillshade"
    NORTHERLY_TILT = "northerly-tilt"
    ROUGHNESS = "roughness"
    INSOLATION = "insolation"
    HAVENS = "havens"
    VIEWSHED = "viewshed"
    HAZARD = "hazard"
    CONTOURS = "contours"
    MODEL = "model"
    VIEW_MODEL = "view-model"
    TILESET = "tileset"
    DIPS = "dips"
    POINTS = "points"
    POINT_TILES = "point-tiles"
    PANORAMA = "panorama"
    PANORAMA_GROUND = "panorama-ground"
    FAR_DTM = "far-dtm"
    FAR_HILLSHADE = "far-hillshade"
    FAR_CONTOURS = "far-contours"
    REGION_DTM = "region-dtm"
    REGION_SEAMS = "region-seams"
    REGION_HILLSHADE = "region-hillshade"
    REGION_SLOPE = "region-slope"
    REGION_ASPECT = "region-aspect"
    REGION_NORTHERLY_TILT = "region-northerly-tilt"
    REGION_ROUGHNESS = "region-roughness"
    REGION_INSOLATION = "region-insolation"
    REGION_HAVENS = "region-havens"
    REGION_HAZARD = "region-hazard"
    REGION_CONTOURS = "region-contours"
    TRAVERSE = "traverse"
    TRAVERSE_TABLE = "traverse-table"
    TRAVERSE_FIGURE = "traverse-figure"
    TRAVERSE_PICTURE = "traverse-picture"
    TRAVERSE_PACKAGE = "traverse-package"
    PLACES = "places"
    SITE_VECTORS = "site-vectors"
    ROVER_VECTORS = "rover-vectors"
    MISSION_TRAVERSE = "mission-traverse"
    MISSION_STOPS = "mission-stops"
    ORBITAL_IMAGE = "orbital-image"
    ORBITAL_REGISTRATION = "orbital-registration"
    ORBITAL = "orbital"
    CONTROL_FILE = "control-file"
    CONTROL = "control"
    STOPS = "stops"
    FOOTPRINTS = "footprints"
    POINTING = "pointing"
    TIE_POINTS = "tie-points"
    QUICKLOOK = "quicklook"


SUFFIX = {
    ProductKind.IMAGE: ".img",
    ProductKind.BROWSE: ".png",
    ProductKind.VECTORS: ".xml",
    ProductKind.RADIOMETRY: ".npz",
    ProductKind.MATCHES: ".npz",
    ProductKind.PARALLAX: ".npz",
    ProductKind.TIES: ".npz",
    ProductKind.LINKS: ".npz",
    ProductKind.MANUAL_TIES: ".txt",
    ProductKind.NETWORK: ".json",
    ProductKind.MARGINALISED_STOP: ".json",
    ProductKind.ORIENTATIONS: ".json",
    ProductKind.QUALITY: ".json",
    ProductKind.REPORT: ".html",
    ProductKind.DTM: ".tif",
    ProductKind.ORTHOPHOTO: ".tif",
    ProductKind.SOURCES: ".tif",
    ProductKind.COLOUR: ".tif",
    ProductKind.SLOPE: ".tif",
    ProductKind.ASPECT: ".tif",
    ProductKind.HILLSHADE: ".tif",
    ProductKind.NORTHERLY_TILT: ".tif",
    ProductKind.ROUGHNESS: ".tif",
    ProductKind.INSOLATION: ".tif",
    ProductKind.HAVENS: ".geojson",
    ProductKind.VIEWSHED: ".tif",
    ProductKind.HAZARD: ".tif",
    ProductKind.CONTOURS: ".geojson",
    ProductKind.MODEL: ".glb",
    ProductKind.VIEW_MODEL: ".glb",
    ProductKind.TILESET: ".3tz",
    ProductKind.DIPS: ".geojson",
    ProductKind.POINTS: ".ply",
    ProductKind.POINT_TILES: ".3tz",
    ProductKind.PANORAMA: ".tif",
    ProductKind.PANORAMA_GROUND: ".tif",
    ProductKind.FAR_DTM: ".tif",
    ProductKind.FAR_HILLSHADE: ".tif",
    ProductKind.FAR_CONTOURS: ".geojson",
    ProductKind.REGION_DTM: ".tif",
    ProductKind.REGION_SEAMS: ".tif",
    ProductKind.REGION_HILLSHADE: ".tif",
    ProductKind.REGION_SLOPE: ".tif",
    ProductKind.REGION_ASPECT: ".tif",
    ProductKind.REGION_NORTHERLY_TILT: ".tif",
    ProductKind.REGION_ROUGHNESS: ".tif",
    ProductKind.REGION_INSOLATION: ".tif",
    ProductKind.REGION_HAVENS: ".geojson",
    ProductKind.REGION_HAZARD: ".tif",
    ProductKind.REGION_CONTOURS: ".geojson",
    ProductKind.TRAVERSE: ".geojson",
    ProductKind.TRAVERSE_TABLE: ".json",
    ProductKind.TRAVERSE_FIGURE: ".svg",
    ProductKind.TRAVERSE_PICTURE: ".png",
    ProductKind.TRAVERSE_PACKAGE: ".gpkg",
    ProductKind.PLACES: ".csv",
    ProductKind.SITE_VECTORS: ".svf",
    ProductKind.ROVER_VECTORS: ".rvf",
    ProductKind.MISSION_TRAVERSE: ".geojson",
    ProductKind.MISSION_STOPS: ".geojson",
    ProductKind.ORBITAL_IMAGE: ".tif",
    ProductKind.ORBITAL_REGISTRATION: ".json",
    ProductKind.ORBITAL: ".tif",
    ProductKind.CONTROL_FILE: ".txt",
    ProductKind.CONTROL: ".json",
    ProductKind.STOPS: ".geojson",
    ProductKind.FOOTPRINTS: ".geojson",
    ProductKind.POINTING: ".geojson",
    ProductKind.TIE_POINTS: ".geojson",
    ProductKind.QUICKLOOK: ".png",
}


FAR = {
    ProductKind.DTM: ProductKind.FAR_DTM,
    ProductKind.HILLSHADE: ProductKind.FAR_HILLSHADE,
    ProductKind.CONTOURS: ProductKind.FAR_CONTOURS,
}
"""Kinds of a stop's map, and of its map of far ground: layers of their own beside each other."""
REGION = {
    ProductKind.DTM: ProductKind.REGION_DTM,
    ProductKind.HILLSHADE: ProductKind.REGION_HILLSHADE,
    ProductKind.SLOPE: ProductKind.REGION_SLOPE,
    ProductKind.ASPECT: ProductKind.REGION_ASPECT,
    ProductKind.NORTHERLY_TILT: ProductKind.REGION_NORTHERLY_TILT,
    ProductKind.ROUGHNESS: ProductKind.REGION_ROUGHNESS,
    ProductKind.INSOLATION: ProductKind.REGION_INSOLATION,
    ProductKind.HAVENS: ProductKind.REGION_HAVENS,
    ProductKind.HAZARD: ProductKind.REGION_HAZARD,
    ProductKind.CONTOURS: ProductKind.REGION_CONTOURS,
}
"""The same for the map of all stops of a mission together."""
MAPPED = {ProductKind.FAR_DTM: FAR, ProductKind.REGION_DTM: REGION}
"""By the kind of the terrain model that a map is made from."""


class ScopeLevel(StrEnum):
    """What a product is about."""

    IMAGE = "image"
    PAIR = "pair"
    STOP = "stop"
    SOL = "sol"
    REGION = "region"


LEVEL = {
    ProductKind.IMAGE: ScopeLevel.IMAGE,
    ProductKind.BROWSE: ScopeLevel.IMAGE,
    ProductKind.VECTORS: ScopeLevel.REGION,
    ProductKind.RADIOMETRY: ScopeLevel.REGION,
    ProductKind.MATCHES: ScopeLevel.PAIR,
    ProductKind.PARALLAX: ScopeLevel.PAIR,
    ProductKind.TIES: ScopeLevel.STOP,
    ProductKind.LINKS: ScopeLevel.STOP,
    ProductKind.MANUAL_TIES: ScopeLevel.REGION,
    ProductKind.PANORAMA_GROUND: ScopeLevel.STOP,
    ProductKind.NETWORK: ScopeLevel.SOL,
    ProductKind.MARGINALISED_STOP: ScopeLevel.STOP,
    ProductKind.ORIENTATIONS: ScopeLevel.SOL,
    ProductKind.QUALITY: ScopeLevel.SOL,
    ProductKind.REPORT: ScopeLevel.SOL,
    ProductKind.TRAVERSE_TABLE: ScopeLevel.REGION,
    ProductKind.TRAVERSE_FIGURE: ScopeLevel.REGION,
    ProductKind.TRAVERSE_PICTURE: ScopeLevel.REGION,
    ProductKind.TRAVERSE_PACKAGE: ScopeLevel.REGION,
    ProductKind.PLACES: ScopeLevel.REGION,
    ProductKind.SITE_VECTORS: ScopeLevel.REGION,
    ProductKind.ROVER_VECTORS: ScopeLevel.REGION,
    ProductKind.ORBITAL_IMAGE: ScopeLevel.REGION,
    ProductKind.ORBITAL_REGISTRATION: ScopeLevel.REGION,
    ProductKind.CONTROL_FILE: ScopeLevel.REGION,
    ProductKind.CONTROL: ScopeLevel.REGION,
}
"""The level of the products that stages hand to each other."""


@dataclass(frozen=True, slots=True, order=True)
class Scope:
    """What a product is about: one image, pair, stop or sol, or the whole region of a mission.

    `name` is lower case and safe in paths and URLs: `mer2-site0010-drive0064`, `mer2-sol0156`,
    `mer2` for the region.
    """

    level: ScopeLevel
    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True, order=True)
class ProductRef:
    """A few bytes that stand for a product; the store turns them into a path."""

    kind: ProductKind
    scope: Scope
    digest: str
    """Hexadecimal digest of the recipe, 16 digits."""

    def map_kind(self, kind: ProductKind) -> ProductKind:
        """The kind of a map made from this terrain model: of a stop, of far ground, of a region."""
        return MAPPED[self.kind][kind] if self.kind in MAPPED else kind

    @property
    def text(self) -> str:
        """All of it in one line, for documents; `of_text` reads it."""
        return f"{self.kind}/{self.scope.level}/{self.scope.name}/{self.digest}"

    @classmethod
    def of_text(cls, text: str) -> ProductRef:
        """What `text` wrote."""
        kind, level, scope, digest = text.split("/")
        return cls(ProductKind(kind), Scope(ScopeLevel(level), scope), digest)

    @property
    def file_name(self) -> str:
        """The file's place below the folder of products."""
        return f"{self.kind}/{self.scope.name}/{self.digest}{SUFFIX[self.kind]}"


@dataclass(frozen=True)
class Recipe:
    """All that determines a product."""

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
        """The reference of the product this recipe makes."""
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
    """A published product as the map and its users see it.

    Bounds are (west, south, east, north) in metres of the mission's local map; for rasters the
    range of values is that of the first band, for stretch and legend.
    """

    ref: ProductRef
    mission: str
    title: str
    type: Literal["raster", "vector", "model", "panorama"]
    """Models and panoramas are not on the map: they are looked at elsewhere."""
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
