"""Pruning a store that flows filled: published products stay, and a rerun makes nothing."""

from datetime import timedelta
from pathlib import Path

import pytest

from solmap.products.catalogue.maintenance.pruning import PruningParams, prune
from solmap.products.catalogue.workspace import Workspace
from tests.support.small_downlink import write_coarse_pipeline, write_small_downlink
from tests.support.store_checks import Contents, faults

pytestmark = [pytest.mark.usefixtures("engine"), pytest.mark.slow]
ALL_OLD = PruningParams(versions=1, youngest=timedelta(0))


def test_reprocessing_keeps_old_products_until_they_are_pruned(tmp_path: Path) -> None:
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings

    downlink = write_small_downlink(tmp_path / "downlink", pairs=2)
    pipeline = write_coarse_pipeline(tmp_path / "coarse.toml")
    root = tmp_path / "store"
    workspace = Workspace.open(root)
    process_downlink(downlink, root, str(pipeline))
    first = Contents.of(root)
    assert prune(workspace, ALL_OLD) == []

    pipeline.write_text(pipeline.read_text() + "[slope]\nbaseline_m = 0.8\n")
    process_downlink(downlink, root, str(pipeline))
    assert first.products.keys() <= Contents.of(root).products.keys()

    gone = {str(one.ref.kind) for one in prune(workspace, ALL_OLD)}
    assert "slope" in gone
    assert not gone & {"image", "matches", "network", "dtm", "orthophoto"}
    assert faults(root) == []
    for layer in workspace.catalogue.layers():
        assert workspace.store.path(layer.ref).is_file()
    pruned = Contents.of(root)
    process_downlink(downlink, root, str(pipeline))
    assert Contents.of(root).products == pruned.products
