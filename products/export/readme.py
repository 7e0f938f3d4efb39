"""The README of an export: its files, their position on Mars, and how to open them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.crs import local_crs
from solmap.products.export.selection import EPIPOLAR, EXCHANGE
from solmap.products.model import Layer
from solmap.products.store.provenance import SOFTWARE

_USE = """
## How to open it

- **QGIS** 3.22 or newer: open the project of a map ({projects}). All layers are in it, with colours
  and legends.
- **GDAL**, rasterio, geopandas: `maps/*.tif` are Cloud Optimised GeoTIFFs, NaN or 0 where nothing
  was measured; `maps/*.geojson` are features in degrees of Mars (IAU_2015:49900), or in metres of
  the map where it is not tied to the lander.
- **STAC**: `pystac.Catalog.from_file("stac/catalog.json")`. Beside each item lies how its file was
  made (`*_provenance.json`).
- `*.glb`, `*.ply`, `*.3tz`: models, point clouds and 3D tiles, for three.js, MeshLab, Cesium.

GeoTIFFs have the tags MISSION, SOL, SITE, DRIVE, INSTRUMENT and LOCAL_TIME (true solar time of the
first and the last exposure of a day), beside all parameters that they were made with.
"""
_FOLDERS = {
    "traverse": (
        "PLACES table (CSV), site and rover vector files (SVF, RVF), the traverse with error "
        "ellipses (GeoPackage), and the differences to telemetry"
    ),
    "reports": "quality of every adjustment, and the report of each sol",
    **EXCHANGE,
    EPIPOLAR: "images of the stereo pairs resampled to epipolar geometry, without distortion",
}


def readme_text(
    maps: Sequence[tuple[MissionEntry, Sequence[Layer]]], names: Collection[str]
) -> str:
    """The README of some maps with their layers, in Markdown.

    Args:
        maps: The maps of the export, each with the selected layers.
        names: Of all files of the export.
    """
    lines = [
        "# Maps from the stereo images of rovers",
        "",
        f"Made with {SOFTWARE}. `sha256sum --check SHA256SUMS` checks that all files are "
        "unchanged.",
    ]
    for entry, layers in maps:
        lines += ["", *_about(entry), *_table(layers)]
    projects = ", ".join(f"`{name}`" for name in sorted(names) if name.endswith(".qgz"))
    if projects:
        lines += _USE.format(projects=projects).rstrip().split("\n")
    found = {name.split("/")[0] for name in names if "/" in name}
    others = [f"- `{name}/`: {text}" for name, text in _FOLDERS.items() if name in found]
    if others:
        lines += ["", "## Other folders", "", *others]
    return "\n".join((*lines, ""))


def _about(entry: MissionEntry) -> Iterator[str]:
    """Description of a map and its position."""
    landing = entry.landing
    yield f"## {entry.title} ({entry.mission})"
    yield ""
    if landing.origin:
        yield f"**{landing.name[0].upper()}{landing.name[1:]}.** Where the map lies"
        yield "is not known; coordinates are metres east, north and up from its origin."
    else:
        yield f"Coordinates are metres east and north of {landing.name} (longitude "
        yield f"{landing.longitude} E, latitude {landing.latitude}, planetocentric; radius "
        yield f"{landing.radius_m:.0f} m; {landing.source}), elevations are metres above the "
        yield "tangent plane there."
    if entry.lsl_note:
        yield f"Note: {entry.lsl_note}."
    yield f"Coordinate system of the rasters: `{local_crs(landing).name}`."


def _table(layers: Sequence[Layer]) -> Iterator[str]:
    if not layers:
        return
    yield ""
    yield "| file in `maps/` | what it shows | unit |"
    yield "| --- | --- | --- |"
    for layer in layers:
        name = f"{layer.readable_name}{layer.ref.kind.suffix}"
        yield f"| `{name}` | {layer.full_title} | {layer.unit or ''} |"
