"""The report of a sol as a PDF: its results, its maps, its images.

The first page has the figures of the HTML report in short; pages of maps follow, one per layer with
the colours of the server's map and a scale in metres of the map, then thumbnails of the images. It
contains no creation date, so the same products give the same bytes.
"""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterator, Sequence
from typing import TypeVar

import cv2
import numpy as np
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError
from solmap.products.formats.raster.raster import band_names, class_names, open_raster
from solmap.products.formats.raster.styles import STYLES, TileStyle, range_of
from solmap.products.model import Layer, ScopeLevel
from solmap.products.reports.sol_report import SolFacts, sol_facts, thumbnail, why_unpaired
from solmap.products.store.provenance import SOFTWARE

_T = TypeVar("_T")
A4 = (8.27, 11.69)
MAPS_A_PAGE, IMAGES_A_PAGE = (3, 2), (7, 5)
"""Rows and columns."""
MOST_IMAGES = 70
_THUMBNAIL_PX = 500
"""Longest side of a map's raster."""
_MOST_LINES, _WIDTH = 30, 105
"""Notes on the first page: lines, and letters per line."""


def sol_pdf(mission: str, sol: int, workspace: Workspace) -> bytes:
    """The report of a sol.

    Raises:
        ProductNotFoundError: the store has no image of that sol.
    """
    facts = sol_facts(mission, sol, workspace)
    body = io.BytesIO()
    title = f"{facts.mission}, sol {facts.sol}"
    metadata = {"Title": title, "Creator": SOFTWARE, "CreationDate": None, "ModDate": None}
    with PdfPages(body, metadata=metadata) as pages:
        pages.savefig(_first_page(title, workspace.catalogue.mission(facts.mission).title, facts))
        for figure in (*_map_pages(facts, workspace), *_image_pages(facts, workspace)):
            pages.savefig(figure)
    return body.getvalue()


def _first_page(title: str, place: str, facts: SolFacts) -> Figure:
    figure = Figure(figsize=A4)
    figure.text(0.08, 0.94, title, fontsize=20, weight="bold")
    made = (facts.network or {}).get("made_at", "not yet")
    figure.text(0.08, 0.92, f"{place}; {SOFTWARE}; adjusted {made}", fontsize=9, color="#555555")
    linked = sum(1 for link in facts.links if link.get("linked"))
    counts = (
        (len(facts.images), "images"),
        (len(facts.pairs), "matched pairs"),
        (len(facts.unpaired), "unpaired images"),
        (f"{linked} of {len(facts.links)}", "links to other stops"),
        (len(facts.layers), "layers"),
        (len(facts.failures), "failures"),
    )
    for number, (count, what) in enumerate(counts):
        left = 0.08 + 0.14 * number
        figure.text(left, 0.875, str(count), fontsize=15)
        figure.text(left, 0.86, what, fontsize=7, color="#555555")
    figure.text(0.08, 0.82, "\n".join(_lines(facts)), fontsize=9, va="top", linespacing=1.4)
    return figure


def _lines(facts: SolFacts) -> Iterator[str]:
    """Adjustment, failures, findings and unpaired images, line by line."""
    adjustment = (facts.quality or {}).get("adjustment") or {}
    sections = (
        ("Adjustment", [str(adjustment.get("summary", "no stop of the sol was adjusted"))]),
        ("Failures", facts.failures),
        ("Findings", facts.notes),
        (
            "Without stereo partner",
            [f"{count} images: {reason}" for reason, count in why_unpaired(facts.unpaired)],
        ),
    )
    for name, texts in sections:
        if not texts:
            continue
        yield name
        lines = [line for text in texts for line in textwrap.wrap(text, _WIDTH)]
        yield from (f"   {line}".replace("$", r"\$") for line in lines[:_MOST_LINES])
        if len(lines) > _MOST_LINES:
            yield f"   and {len(lines) - _MOST_LINES} more lines"
        yield ""


def _map_pages(facts: SolFacts, workspace: Workspace) -> Iterator[Figure]:
    shown = [
        layer
        for kind in STYLES
        for layer in facts.layers
        if layer.ref.kind is kind and layer.ref.scope.level is ScopeLevel.STOP
    ]
    shown.sort(key=lambda layer: layer.ref.scope.name)
    rows, cols = MAPS_A_PAGE
    for some in _batches(shown, rows * cols):
        figure = Figure(figsize=A4, layout="constrained")
        for number, layer in enumerate(some, start=1):
            axes = figure.add_subplot(rows, cols, number)
            try:
                image, ramp = _image_of(layer, workspace)
            except ProductError as error:
                axes.text(0.5, 0.5, textwrap.fill(str(error), 40), ha="center", fontsize=7)
                continue
            west, south, east, north = layer.bounds
            axes.imshow(image, extent=(west, east, south, north), interpolation="nearest")
            axes.set_title(layer.full_title, fontsize=7)
            axes.tick_params(labelsize=6)
            if ramp is not None:
                bar = figure.colorbar(ramp, ax=axes, shrink=0.7)
                bar.ax.tick_params(labelsize=6)
                bar.set_label(STYLES[layer.ref.kind].unit or layer.unit or "", fontsize=6)
        yield figure


def _image_of(layer: Layer, workspace: Workspace) -> tuple[np.ndarray, ScalarMappable | None]:
    """A layer in its colours, shrunk, white where nothing is known; and its ramp, if it has one."""
    style = STYLES[layer.ref.kind]
    with open_raster(workspace.store.path(layer.ref)) as dataset:
        scale = max(1.0, max(dataset.shape) / _THUMBNAIL_PX)
        rows, cols = (max(1, round(side / scale)) for side in dataset.shape)
        if style.is_colour:
            bands = dataset.read((1, 2, 3), out_shape=(3, rows, cols))
            return np.where(bands.max(axis=0) > 0, bands, 255).transpose(1, 2, 0), None
        if style.is_classes:
            codes, colours = dataset.read(1, out_shape=(rows, cols)), dataset.colormap(1)
            palette = np.full((256, 3), 255, np.uint8)
            for code in class_names(dataset):
                palette[code] = colours[code][:3]
            return palette[codes], None
        band = band_names(dataset).index(style.band) + 1 if style.band else 1
        values = dataset.read(band, out_shape=(rows, cols), masked=True)
        is_grey = dataset.dtypes[0] == "uint8"
    colours = LinearSegmentedColormap.from_list("ramp", list(style.colours))
    colours = colours.with_extremes(bad="white")
    ramp = ScalarMappable(Normalize(*_ends(layer, style, is_grey=is_grey)), colours)
    invalid = np.ma.getmaskarray(values) | ~np.isfinite(np.ma.getdata(values))
    painted = ramp.to_rgba(np.ma.array(np.ma.getdata(values), mask=invalid))
    return painted, ramp if style.has_legend else None


def _ends(layer: Layer, style: TileStyle, *, is_grey: bool) -> tuple[float, float]:
    return (1.0, 255.0) if is_grey else range_of(style, layer)


def _image_pages(facts: SolFacts, workspace: Workspace) -> Iterator[Figure]:
    rows, cols = IMAGES_A_PAGE
    for some in _batches(facts.images[:MOST_IMAGES], rows * cols):
        figure = Figure(figsize=A4, layout="constrained")
        for number, image in enumerate(some, start=1):
            axes = figure.add_subplot(rows, cols, number)
            axes.set_axis_off()
            small = thumbnail(image, workspace)
            if small is not None:
                grey = cv2.imdecode(np.frombuffer(small, np.uint8), cv2.IMREAD_GRAYSCALE)
                axes.imshow(np.asarray(grey), cmap="gray", vmin=0, vmax=255)
            axes.set_title(f"{image.id}\n{image.instrument} {image.eye}", fontsize=4.5)
        yield figure


def _batches(items: Sequence[_T], size: int) -> Iterator[Sequence[_T]]:
    return (items[start : start + size] for start in range(0, len(items), size))
