"""The report of a sol as a PDF: a page of figures, pages of maps, pages of images."""

import re

import pytest

from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductNotFoundError
from solmap.products.reports.sol_pdf import sol_pdf
from tests.unit.gis_server.conftest import build


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    world = build(tmp_path_factory.mktemp("store"))
    return Workspace(world.store, world.catalogue)


def test_the_report_has_a_page_of_figures_maps_and_images(workspace):
    report = sol_pdf("MER2", 156, workspace)
    assert report.startswith(b"%PDF")
    rasters = sum(layer.type == "raster" for layer in workspace.catalogue.layers("MER2"))
    pages = len(re.findall(rb"/Type /Page\b", report))
    assert pages == 1 + -(-rasters // 6) + 1
    assert report == sol_pdf("MER2", 156, workspace)


def test_a_sol_without_images_is_named(workspace):
    with pytest.raises(ProductNotFoundError, match="MER2 has no image of sol 999"):
        sol_pdf("MER2", 999, workspace)
