"""Commands that take a file refuse FIFOs, devices and links out of the folder; none waits."""

import os
from pathlib import Path

import numpy as np
import pytest

from solmap.config.landing import landing_site
from solmap.config.settings import Settings
from solmap.flows.cli.inspection import inspect_files
from solmap.flows.external_data import take_ties_file
from solmap.flows.traverse import georeference_mosaic
from solmap.products.store.product_store import ProductStore
from solmap.tasks.fetch.images import check_image
from solmap.tasks.mission.imported_traverse import read_traverses
from solmap.tasks.mission.orbital import take_orbital


@pytest.fixture(params=["fifo", "device", "link"])
def no_file(request, tmp_path) -> Path:
    path = tmp_path / "folder" / "x.img"
    path.parent.mkdir()
    if request.param == "fifo":
        os.mkfifo(path)
    elif request.param == "device":
        path.symlink_to("/dev/zero")
    else:
        (tmp_path / "secret").write_text("secret")
        path.symlink_to(tmp_path / "secret")
    return path


REFUSED = r"only regular files are read|leads out of its folder"


def test_every_reader_refuses_non_files(no_file, tmp_path):
    store = ProductStore.open(tmp_path / "store")
    landing = landing_site("MER2", Settings().landing_sites).landing
    for read in (
        lambda: take_orbital(no_file, store),
        lambda: take_ties_file(no_file, store.root),
        lambda: read_traverses([no_file], "MER2", landing),
        lambda: georeference_mosaic(no_file),
        lambda: check_image(no_file),
    ):
        with pytest.raises(OSError, match=REFUSED):
            read()


def test_inspect_names_non_files(no_file):
    findings, (fault,) = inspect_files([no_file])
    assert findings == []
    assert "cannot be read" in fault
    assert "only regular files are read" in fault or "leads out of its folder" in fault


def test_an_orbital_image_is_kept_unchanged(tmp_path):
    data = np.random.default_rng(3).bytes(3_000_000)
    (tmp_path / "map.tif").write_bytes(data)
    store = ProductStore.open(tmp_path / "store")
    assert store.path(take_orbital(tmp_path / "map.tif", store)).read_bytes() == data
