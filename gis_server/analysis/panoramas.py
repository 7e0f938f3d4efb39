"""Queries of panoramas: ground point of a pixel, direction of a ground point."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import rasterio
from pydantic import BaseModel
from rasterio.windows import Window

from solmap.gis_server.rendering.reading import RasterPool
from solmap.photogrammetry.arrays import Vector3
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.orthophoto.panorama_grid import NODE, direction
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.errors import OutsideCoverageError, ProductNotFoundError
from solmap.products.formats.raster.panorama import PanoramaFacts, read_panorama_facts
from solmap.products.model import Layer, ProductKind, ProductRef
from solmap.products.store.product_store import ProductStore

FAR_M = 10_000.0
"""Distance assumed for directions without known ground: far enough to have no parallax."""
HIDDEN_SHARE, HIDDEN_M = 0.03, 0.1
"""Tolerance of the range before nearer ground counts as hiding a place."""
_FACTS = 1024


class GroundSeen(BaseModel):
    """The ground in a direction, metres of the local map, and its distance from the panorama."""

    east: float
    north: float
    up: float
    distance_m: float


class ImagePixel(BaseModel):
    """An image as it was stored, and the pixel of it that is shown."""

    image: str
    sample: float | None
    """Sample of the pixel; null if the latest adjustment moved the image."""
    line: float | None


class DirectionSeen(BaseModel):
    """Image and ground of a panorama in a direction, degrees."""

    azimuth_deg: float
    elevation_deg: float
    ground: GroundSeen | None
    """Ground seen; null in the sky, and on ground outside all terrain models."""
    shown: ImagePixel | None


class PlaceSeen(BaseModel):
    """Direction of a place of the map."""

    azimuth_deg: float
    elevation_deg: float
    distance_m: float
    inside: bool
    """Whether the panorama shows that direction at all."""
    hidden: bool | None
    """Whether nearer ground hides it; None where that is not known."""


@dataclass(frozen=True, slots=True, eq=False)
class PanoramaView:
    """An open panorama and its companion."""

    layer: Layer
    facts: PanoramaFacts
    store: ProductStore
    pool: RasterPool

    @classmethod
    def of(cls, layer: Layer, store: ProductStore, pool: RasterPool) -> PanoramaView:
        """The panorama of a layer."""
        if layer.ref.kind is not ProductKind.PANORAMA:
            raise ProductNotFoundError(f"{layer.id} is not a panorama")
        return cls(layer, facts_of(layer, store, pool), store, pool)

    def direction(
        self, azimuth_deg: float, elevation_deg: float, mission: OrientedMission
    ) -> DirectionSeen:
        """Ground and image in a direction.

        Raises:
            OutsideCoverageError: the panorama does not reach there.
        """
        row, col = self._pixel(azimuth_deg, elevation_deg)
        distance_m, number = self._ground(row, col)
        away = direction(np.array(azimuth_deg), np.array(elevation_deg))
        centre = MAP_FROM_LSL.T @ self.facts.centre
        known = math.isfinite(distance_m)
        there = centre + (distance_m if known else FAR_M) * away
        east, north, up = (round(value, 3) for value in (MAP_FROM_LSL @ there).tolist())
        ground = GroundSeen(east=east, north=north, up=up, distance_m=round(distance_m, 3))
        return DirectionSeen(
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            ground=ground if known else None,
            shown=self._image_pixel(number, there, mission) if math.isfinite(number) else None,
        )

    def place(self, place: Vector3) -> PlaceSeen:
        """Direction of a map point (east, north, up) in the panorama."""
        away = MAP_FROM_LSL.T @ (place - self.facts.centre)
        distance_m = float(np.linalg.norm(away))
        grid = self.facts.grid
        (row,), (col,) = (part.tolist() for part in grid.pixels_of(away[None]))
        inside = -0.5 <= row < grid.rows - 0.5 and -0.5 <= col < grid.cols - 0.5  # noqa: PLR2004 - half a pixel
        nearest = self._ground(row, col)[0] if inside else math.nan
        hides = nearest < distance_m * (1 - HIDDEN_SHARE) - HIDDEN_M
        return PlaceSeen(
            azimuth_deg=round((grid.west_deg + (col + 0.5) * grid.cell_deg) % 360.0, 4),
            elevation_deg=round(grid.top_deg - (row + 0.5) * grid.cell_deg, 4),
            distance_m=round(distance_m, 3),
            inside=inside,
            hidden=hides if math.isfinite(nearest) else None,
        )

    def _pixel(self, azimuth_deg: float, elevation_deg: float) -> tuple[float, float]:
        grid = self.facts.grid
        col = (azimuth_deg - grid.west_deg) % 360.0 / grid.cell_deg - 0.5
        row = (grid.top_deg - elevation_deg) / grid.cell_deg - 0.5
        if not (-0.5 <= row < grid.rows - 0.5 and -0.5 <= col < grid.cols - 0.5):  # noqa: PLR2004 - half a pixel
            raise OutsideCoverageError(
                f"{self.layer.id} does not show azimuth {azimuth_deg:g}, elevation "
                f"{elevation_deg:g} degrees"
            )
        return row, col

    def _ground(self, row: float, col: float) -> tuple[float, float]:
        """Distance of the ground at a pixel, and number of the image that shows it; or NaN."""
        if self.facts.ground is None:
            return math.nan, math.nan
        ref = ProductRef(ProductKind.PANORAMA_GROUND, self.layer.ref.scope, self.facts.ground)
        down, across = round(row / NODE), round(col / NODE)
        with self.pool.reading(self.store.address(ref)) as dataset:
            down, across = min(down, dataset.height - 1), min(across, dataset.width - 1)
            values = dataset.read(window=Window(max(0, across), max(0, down), 1, 1))
        distance_m, number = values[:, 0, 0].tolist()
        return distance_m, number

    def _image_pixel(self, number: float, there: Vector3, mission: OrientedMission) -> ImagePixel:
        name = self.facts.images[int(number) - 1]
        entry = mission.workspace.catalogue.image(name)
        sample, line = mission.oriented_image(entry).camera.project(there[None])[0].tolist()
        on_it = math.isfinite(sample) and math.isfinite(line)
        return ImagePixel(
            image=name,
            sample=round(sample, 2) if on_it else None,
            line=round(line, 2) if on_it else None,
        )


def facts_of(layer: Layer, store: ProductStore, pool: RasterPool) -> PanoramaFacts:
    """The metadata of a panorama; read once, because products never change."""
    return _facts(layer.ref, store, pool)


@lru_cache(maxsize=_FACTS)
def _facts(ref: ProductRef, store: ProductStore, pool: RasterPool) -> PanoramaFacts:
    with pool.reading(store.address(ref)) as dataset:
        return read_panorama_facts(dataset)


def tile_of(dataset: rasterio.DatasetReader, scale: int, x: int, y: int, side: int) -> np.ndarray:
    """One tile of an image reduced by `scale`; 0 where it has no data.

    Raises:
        OutsideCoverageError: the tile lies beyond the image.
    """
    left, top = x * side * scale, y * side * scale
    width, height = (min(side * scale, n) for n in (dataset.width - left, dataset.height - top))
    if width <= 0 or height <= 0:
        raise OutsideCoverageError(f"tile {x}/{y} lies beyond the panorama")
    shape = math.ceil(height / scale), math.ceil(width / scale)
    grey = np.zeros((side, side), np.uint8)
    window = Window(left, top, width, height)
    grey[: shape[0], : shape[1]] = dataset.read(1, window=window, out_shape=shape)
    return grey
