"""STAC: the latest products as a catalogue of plain files, for search by place and time.

    stac/catalog.json                                      all missions
    stac/<mission>/collection.json                         one mission
    stac/<mission>/<scope>-<kind>.json                     one layer: an item, at its latest version

Links are relative, so the folder of the store may be moved or served as it is. The catalogue lies
where the products lie; every file is replaced by a whole one.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

import pystac

from solmap.photogrammetry.terrain.dtm.grid import union
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.model import Layer
from solmap.products.stac_items import ON_MARS, SOLAR_SYSTEM, Taken, degrees, item_id, item_of
from solmap.products.store.product_store import ProductStore

FOLDER = "stac"


def write_items(
    layers: Iterable[tuple[Layer, Taken]], mission: MissionEntry, store: ProductStore
) -> None:
    """Write or replace the items of layers."""
    for layer, taken in layers:
        item = item_of(layer, mission, taken, store)
        document = item.to_dict(include_self_link=False, transform_hrefs=False)
        _write(f"{mission.mission}/{item.id}.json", document, store)


def write_catalogue(
    missions: Sequence[MissionEntry], layers: Sequence[Layer], taken: Taken, store: ProductStore
) -> None:
    """Write the catalogue of all missions and the collection of the one whose layers these are."""
    catalogue = pystac.Catalog("solmap", "Maps made from the stereo images of Mars rovers")
    catalogue.clear_links()
    catalogue.add_link(_link("root", "catalog.json"))
    for mission in missions:
        catalogue.add_link(_link("child", f"{mission.mission}/collection.json", mission.title))
    _write("catalog.json", catalogue.to_dict(include_self_link=False, transform_hrefs=False), store)
    name = layers[0].mission
    entry = next(mission for mission in missions if mission.mission == name)
    collection = _collection(entry, layers, taken)
    document = collection.to_dict(include_self_link=False, transform_hrefs=False)
    _write(f"{name}/collection.json", document, store)


def _collection(mission: MissionEntry, layers: Sequence[Layer], taken: Taken) -> pystac.Collection:
    filled = [layer.bounds for layer in layers if any(layer.bounds)] or [(0.0, 0.0, 0.0, 0.0)]
    extent = union(degrees(bounds, mission.landing) for bounds in filled)
    collection = pystac.Collection(
        id=mission.mission,
        title=mission.title,
        description=f"Latest maps of {mission.title}; places are relative to "
        f"{mission.landing.name} ({mission.landing.source})",
        extent=pystac.Extent(
            pystac.SpatialExtent([[*extent]]),
            pystac.TemporalExtent([[taken.first, taken.last]]),
        ),
        license="other",
        keywords=["Mars", "rover", "stereo", "terrain"],
        stac_extensions=[SOLAR_SYSTEM],
        extra_fields=dict(ON_MARS),
    )
    collection.clear_links()
    collection.add_link(_link("root", "../catalog.json"))
    collection.add_link(_link("parent", "../catalog.json"))
    for layer in layers:
        href = f"{item_id(layer)}.json"
        collection.add_link(pystac.Link("item", href, pystac.MediaType.GEOJSON, layer.title))
    return collection


def _link(rel: str, href: str, title: str | None = None) -> pystac.Link:
    return pystac.Link(rel, href, pystac.MediaType.JSON, title)


def _write(name: str, document: dict[str, Any], store: ProductStore) -> None:
    text = json.dumps(document, indent=1, ensure_ascii=False)
    store.write_document(f"{FOLDER}/{name}", text)
