"""Report: quality of an adjustment, as figures for programs and as a page for people."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

from solmap.photogrammetry.adjustment.quality.network_quality import network_quality
from solmap.photogrammetry.adjustment.quality.records import (
    PairCamera,
    Quality,
    QualityParams,
)
from solmap.products.formats.documents.adjusted_network import quality_document
from solmap.products.formats.documents.archives import read_matches
from solmap.products.formats.documents.network import NetworkProduct, read_network
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.reports.network_figures import (
    growth_figure,
    network_figure,
    residual_figure,
    statistics_figure,
)
from solmap.products.reports.quality_page import report_page
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import PairProducts
from solmap.tasks.stage import stage

FORMAT = "solmap quality 1"


@stage(task_run_name="report-{network.scope}")
def report_quality(
    network: ProductRef, pairs: tuple[PairProducts, ...], params: QualityParams, store: ProductStore
) -> list[ProductRef]:
    """Report the quality of a network, as JSON and as a page; `pairs` are those it may change."""
    inputs = (network, *(pair.matches for pair in pairs))

    @cache
    def evaluate() -> tuple[NetworkProduct, Quality, dict[str, PairCamera]]:
        product = read_network(network, store)
        cameras = {pair.files.id: _camera(pair, store) for pair in pairs}
        return (
            product,
            network_quality(product.adjusted, product.telemetry, cameras, params),
            cameras,
        )

    def write_document(path: Path) -> None:
        product, found, _ = evaluate()
        path.write_text(json.dumps(_document(product, found)))

    def write_page(path: Path) -> None:
        product, found, cameras = evaluate()
        title = f"{product.mission}, adjustment up to sol {product.sol}"
        figures = _figures(product, found, cameras)
        path.write_text(report_page(title, _document(product, found), figures))

    return [
        store.make(Recipe(kind, network.scope, inputs, params), write)
        for kind, write in (
            (ProductKind.QUALITY, write_document),
            (ProductKind.REPORT, write_page),
        )
    ]


def _camera(pair: PairProducts, store: ProductStore) -> PairCamera:
    geometry, _ = read_matches(store.path(pair.matches))
    return PairCamera(pair.files.instrument, geometry.samples, geometry.lines)


def _document(product: NetworkProduct, found: Quality) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "mission": product.mission,
        "sol": product.sol,
        "adjustment": product.report,
        "quality": quality_document(found),
    }


def _figures(
    product: NetworkProduct, found: Quality, cameras: dict[str, PairCamera]
) -> dict[str, bytes]:
    network = product.adjusted
    return {
        "traverse": network_figure(network, product.telemetry, found),
        "growth": growth_figure(found),
        "statistics": statistics_figure(network),
        **{
            camera.instrument: residual_figure(network, cameras, camera) for camera in found.cameras
        },
    }
