"""Tags of a raster: its provenance, and data of its images.

    MISSION     mission of the images: MER2
    SOL         sols on which they were taken, ascending: 155 156
    SITE        sites of their stops
    DRIVE       drives of their stops
    INSTRUMENT  cameras: NAVCAM PANCAM
    LOCAL_TIME  true solar time of the first exposure of a day, or of the first and the last:
                11:02:33/12:45:10

Lists are separated by blanks. The values follow from the inputs of the recipe: the labels of its
images, and the tags of its source rasters. A tag without a value is omitted.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache

from solmap.photogrammetry.archive.images.reading import read_image_record
from solmap.products.formats.raster.raster import open_raster
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.products.store.provenance import provenance_tags

ORIGIN_TAGS = ("MISSION", "SOL", "SITE", "DRIVE", "INSTRUMENT", "LOCAL_TIME")


def raster_tags(recipe: Recipe, store: ProductStore) -> dict[str, str]:
    """Provenance of a raster, and mission, sols, stops, cameras and local times of its images."""
    return {**origin_tags(recipe.inputs, store), **provenance_tags(recipe)}


def origin_tags(inputs: Iterable[ProductRef], store: ProductStore) -> dict[str, str]:
    """Data of the images of some products."""
    found: dict[str, set[str]] = {name: set() for name in ORIGIN_TAGS}
    for ref in inputs:
        for name, values in _values(ref, store):
            found[name].update(values)
    times = sorted(found.pop("LOCAL_TIME"))
    tags = {name: " ".join(sorted(values, key=_order)) for name, values in found.items()}
    tags["LOCAL_TIME"] = "/".join(dict.fromkeys([*times[:1], *times[-1:]]))
    return {name: text for name, text in tags.items() if text}


def _order(value: str) -> tuple[int, str]:
    """Numbers by their size."""
    return (int(value) if value.isdigit() else 0), value


def _values(ref: ProductRef, store: ProductStore) -> Iterator[tuple[str, list[str]]]:
    if ref.kind is ProductKind.IMAGE:
        yield from _values_of_image(ref, store).items()
    elif ref.kind.suffix == ProductKind.DTM.suffix:
        with open_raster(store.path(ref)) as dataset:
            tags = dataset.tags()
        for name in ORIGIN_TAGS:
            yield name, tags.get(name, "").replace("/", " ").split()


@lru_cache(maxsize=1 << 12)
def _values_of_image(ref: ProductRef, store: ProductStore) -> dict[str, list[str]]:
    """Read once per process: each raster of a stop is of the same images."""
    image = read_image_record(store.path(ref).read_bytes(), f"{ref.scope.name}.img")
    stop, time = image.stop, image.local_solar_time
    values = (stop.mission, image.sol, stop.site, stop.drive, image.instrument)
    return {
        **{name: [str(value)] for name, value in zip(ORIGIN_TAGS, values, strict=False)},
        "LOCAL_TIME": [time] if time else [],
    }
