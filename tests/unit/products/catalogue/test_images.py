"""Labels come back from the catalogue as they were read from their images, bit for bit."""

import numpy as np
import pytest

from solmap.photogrammetry.archive.images.reading import read_image_record
from solmap.photogrammetry.archive.images.record_json import label_of_text, text_of_label
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.synthetic.edr import label_bytes
from solmap.photogrammetry.synthetic.mission import (
    MissionPlan,
    exposures,
    mission_names,
    simulate_mission,
)
from solmap.products.catalogue import images
from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.images import LabelCache
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from tests.unit.products.catalogue.test_catalogue import an_image

PLAN = MissionPlan(stops=2, distance_m=20.0, gaps=0, control_every=0)


@pytest.fixture(scope="module")
def labels():
    rng = np.random.default_rng(1)
    mission = simulate_mission(rng, PLAN, names=mission_names(PLAN))
    pairs = list(exposures(mission, PLAN))[:3]
    return {one.product_id: label_bytes(one) for pair in pairs for one in pair}


def test_a_stored_label_is_read_back_unchanged(labels):
    for name, data in labels.items():
        label = read_image_record(data, f"{name}.IMG")
        again = label_of_text(text_of_label(label))
        for part in ("id", "stop", "sol", "eye", "clock", "motion_counter", "mast_in_rover"):
            assert getattr(again, part) == getattr(label, part)
        assert type(again.camera) is type(label.camera)
        np.testing.assert_array_equal(again.camera.c, label.camera.c)
        np.testing.assert_array_equal(
            again.site_from_rover.rotation, label.site_from_rover.rotation
        )
        assert text_of_label(again) == text_of_label(label)


def test_labels_of_every_real_camera_are_stored(shared_data):
    cameras = set()
    for path in sorted(shared_data.rglob("*.[iI][mM][gG]")):
        try:
            label = read_image_record(path.read_bytes(), path.name)
        except PhotogrammetryError:
            continue  # its label is a file of its own
        again = label_of_text(text_of_label(label))
        assert text_of_label(again) == text_of_label(label)
        assert type(again.camera) is type(label.camera)
        cameras.add(type(label.camera).__name__)
    assert {"Cahv", "Cahvor"} <= cameras


def test_a_second_process_reads_no_image(labels, tmp_path, catalogue_url):
    workspace = Workspace(ProductStore.open(tmp_path), Catalogue.open(tmp_path, catalogue_url))
    entries = []
    for number, (name, data) in enumerate(labels.items()):
        scope = Scope(ScopeLevel.IMAGE, name.lower())
        ref = ProductRef(ProductKind.IMAGE, scope, f"{number:016d}")
        path = tmp_path / "products" / "image" / scope.name / f"{ref.digest}.img"
        path.parent.mkdir(parents=True)
        path.write_bytes(data)
        entry = an_image(name)
        entries.append(type(entry)(**{**_fields(entry), "ref": ref}))
    first = images.image_records(entries, workspace)
    images._remembered.clear()
    for path in tmp_path.rglob("*.img"):
        path.unlink()
    again = images.image_records(entries, workspace)
    assert [text_of_label(one) for one in again] == [text_of_label(one) for one in first]
    digests = [entry.ref.digest for entry in entries]
    assert set(LabelCache(workspace.catalogue.engine).find([*digests, "f" * 16])) == set(digests)


def _fields(entry):
    return {name: getattr(entry, name) for name in type(entry).__slots__}
