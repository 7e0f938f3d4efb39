"""Content of an export: products under readable names, and their descriptions.

    README.md             what lies where, and how to open it
    SHA256SUMS            checksums of all files (`products.export.writing`)
    MER2.qgz              QGIS project of a map
    maps/                 layers: GeoTIFF, GeoJSON, models, panoramas
    stac/                 STAC catalogue of the same files, with how each was made
    traverse/             PLACES table, site and rover vector files, GeoPackage, figures
    reports/              pages of adjustments, reports of sols
    colmap/ asp/ isis/    cameras and tie points for other programs, on request
    epipolar/             the images of these
    pds/                  XYZ, range, normals and slope of stereo pairs, on request

Sites not tied to the lander have their own maps, projects and names.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError
from solmap.products.export.exchange import exchange_files
from solmap.products.export.qgis_project import MapFile, project_bytes
from solmap.products.export.readme import readme_text
from solmap.products.export.selection import REPORTS, TRAVERSE, Selection
from solmap.products.export.writing import (
    ExportFile,
    Written,
    check_target,
    is_archive,
    write_archive,
    write_folder,
)
from solmap.products.model import Layer, ProductKind, ProductRef
from solmap.products.reports.sol_pdf import sol_pdf
from solmap.products.reports.stac import (
    AcquisitionTimes,
    catalogue_document,
    collection_document,
    item_of,
)

_TABLES = (
    ProductKind.PLACES,
    ProductKind.SITE_VECTORS,
    ProductKind.ROVER_VECTORS,
    ProductKind.TRAVERSE_PACKAGE,
    ProductKind.TRAVERSE_TABLE,
    ProductKind.TRAVERSE_FIGURE,
)
_SOL = re.compile(r"-sol(\d+)")


@dataclass(frozen=True, slots=True)
class _Export:
    """An export in preparation."""

    selection: Selection
    workspace: Workspace
    scratch: Path
    """Folder for files that are made for the export."""
    files: dict[str, ProductRef | Path]
    """Files by name."""

    def add(self, name: str, content: ProductRef | bytes | str) -> None:
        """Add a product, or a file with some content."""
        if name in self.files:
            raise ProductError(f"two files of the export would be called {name}")
        if isinstance(content, ProductRef):
            self.files[name] = content
            return
        path = self.scratch / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        self.files[name] = path


def export(
    target: Path, selection: Selection, workspace: Workspace
) -> tuple[Written, tuple[str, ...]]:
    """Export the selection as a folder, or as a ZIP archive where the target ends in `.zip`.

    Args:
        target: The folder or archive; an earlier export is updated.
        selection: Selection of products.
        workspace: The store, which is only read.

    Returns:
        What was written, and the names of all files of the export.

    Raises:
        ProductError: nothing is selected, or the target has other content.
        OSError: the target cannot be written.
    """
    store = workspace.store
    check_target(target, store)
    target.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{target.name}-", dir=target.parent) as scratch:
        gathered = _Export(selection, workspace, Path(scratch), {})
        _gather(gathered)
        files = [ExportFile.of(name, source, store) for name, source in gathered.files.items()]
        write = write_archive if is_archive(target) else write_folder
        return write(target, files, store), tuple(sorted(gathered.files))


def _gather(out: _Export) -> None:
    catalogue = out.workspace.catalogue
    entries = [entry for entry in catalogue.missions() if out.selection.has_map(entry.mission)]
    maps = [
        (entry, list(filter(out.selection.has_layer, catalogue.layers(entry.mission))))
        for entry in entries
    ]
    for entry, layers in maps:
        _add_maps(entry, layers, out)
        for ref, folder in _documents(entry, out):
            out.add(f"{folder}/{ref.readable_name(entry.mission)}{ref.kind.suffix}", ref)
        for sol in _reported_sols(entry, layers, out):
            report = sol_pdf(entry.mission, sol, out.workspace)
            out.add(f"{REPORTS}/{entry.mission}_sol{sol:04d}.pdf", report)
        for name, content in exchange_files(entry, out.selection, out.workspace):
            out.add(name, content)
    if not out.files:
        known = ", ".join(entry.mission for entry in catalogue.missions()) or "no mission"
        raise ProductError(f"nothing is selected; {out.workspace.store.root} contains {known}")
    mapped = [entry for entry, layers in maps if layers]
    if mapped:
        out.add("stac/catalog.json", _json(catalogue_document(mapped)))
    out.add("README.md", readme_text(maps, out.files))


def _reported_sols(entry: MissionEntry, layers: Sequence[Layer], out: _Export) -> list[int]:
    """The sols of a map whose reports are exported."""
    if not out.selection.has(REPORTS):
        return []
    images = out.workspace.catalogue.images(entry.mission)
    sols = {image.sol for image in images if out.selection.has_image(image)}
    fresh = {sol for layer in layers for sol in layer.sols}
    return sorted(sols & fresh if out.selection.since else sols)


def _add_maps(entry: MissionEntry, layers: Sequence[Layer], out: _Export) -> None:
    """The layers of a map, their STAC items, and a QGIS project for them."""
    if not layers:
        return
    store, images = out.workspace.store, out.workspace.catalogue.images(entry.mission)
    shown: list[MapFile] = []
    for layer in layers:
        name = f"{layer.readable_name}{layer.ref.kind.suffix}"
        out.add(f"maps/{name}", layer.ref)
        if layer.type in {"raster", "vector"}:
            shown.append(MapFile(layer, store.path(layer.ref), f"./maps/{name}"))
        notes = f"{layer.readable_name}_provenance.json"
        item = item_of(layer, entry, AcquisitionTimes.of_images(layer, images), store)
        item.assets["data"].href = f"../../maps/{name}"
        item.assets["provenance"].href = notes
        document = item.to_dict(include_self_link=False, transform_hrefs=False)
        out.add(f"stac/{entry.mission}/{item.id}.json", _json(document))
        out.add(f"stac/{entry.mission}/{notes}", _json(store.provenance(layer.ref)))
    times = AcquisitionTimes.of(layers[0], (image.start_time for image in images))
    collection = collection_document(entry, layers, times)
    out.add(f"stac/{entry.mission}/collection.json", _json(collection))
    if shown:
        out.add(f"{entry.mission}.qgz", project_bytes(entry.title, entry.landing, shown))


def _documents(entry: MissionEntry, out: _Export) -> Iterator[tuple[ProductRef, str]]:
    """Products of a map that are not layers, and their folders."""
    catalogue, store = out.workspace.catalogue, out.workspace.store
    names = sorted((one.mission.lower() for one in catalogue.missions()), key=len, reverse=True)
    for kind in (*_TABLES, ProductKind.REPORT):
        for ref in catalogue.pointers(kind):
            scope = ref.scope.name
            owner = next((n for n in names if scope == n or scope.startswith(f"{n}-")), None)
            sols = frozenset(int(number) for number in _SOL.findall(scope))
            if owner == entry.mission.lower() and out.selection.has_file(
                ref, sols, store.made_at(ref)
            ):
                yield ref, REPORTS if kind is ProductKind.REPORT else TRAVERSE


def _json(document: object) -> str:
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"
