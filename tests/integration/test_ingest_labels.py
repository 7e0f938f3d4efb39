"""Labels on their way through ingestion: in files of their own, and as links between sites."""

from dataclasses import replace

import numpy as np

from photogrammetry.frames import LSL, Pose, site_frame
from photogrammetry.imagery import StopId
from photogrammetry.pds3.reading import read_image, read_image_record
from products.workspace import Workspace
from tasks.images import image_record
from tasks.ingest import ingest_downlink
from tasks.telemetry import read_telemetry

MSL = "NLB_517261274EDR_F0541610CCAM15900M1"


def without_label(data: bytes) -> bytes:
    """The pixels of Curiosity's image alone."""
    return data[-1024 * 1024 * 2 :]


def test_an_image_whose_label_lies_beside_it_is_ingested(shared_data, tmp_path):
    path = next(shared_data.rglob(f"{MSL}.IMG"))
    data = path.read_bytes()
    label = path.with_suffix(".LBL").read_text("latin-1")
    record = label.index(",23)")
    downlink = tmp_path / "downlink"
    downlink.mkdir()
    (downlink / f"{MSL}.IMG").write_bytes(without_label(data))
    (downlink / f"{MSL}.LBL").write_text(label[:record] + ",1)" + label[record + 4 :])
    workspace = Workspace.open(tmp_path / "store")
    delivery = ingest_downlink.fn(downlink, workspace)
    assert not delivery.faults
    (entry,) = workspace.catalogue.images()
    assert entry.id == MSL
    kept = workspace.store.path(entry.ref).read_bytes()
    np.testing.assert_array_equal(
        read_image(kept, f"{entry.id}.IMG").pixels, read_image(data, path.name).pixels
    )
    assert image_record(entry, workspace).stop == delivery.images[0].stop


def test_an_image_with_a_label_of_its_own_is_kept_as_it_came(shared_data, tmp_path):
    path = next(shared_data.rglob(f"{MSL}.IMG"))
    downlink = tmp_path / "downlink"
    downlink.mkdir()
    (downlink / path.name).write_bytes(path.read_bytes())
    (downlink / f"{MSL}.LBL").write_text("no label at all")
    workspace = Workspace.open(tmp_path / "store")
    assert not ingest_downlink.fn(downlink, workspace).faults
    (entry,) = workspace.catalogue.images()
    assert workspace.store.path(entry.ref).read_bytes() == path.read_bytes()


def test_labels_that_place_their_site_join_the_stops_of_two_sites(shared_data):
    """Without a vector file: site 54 lies in site 53 as its label says."""
    path = next(shared_data.rglob(f"{MSL}.IMG"))
    of_54 = read_image_record(path.read_bytes(), path.name)
    earlier = StopId("MSL", 53, 7)
    of_53 = replace(
        of_54,
        stop=earlier,
        site_from_rover=Pose.identity(site_frame(53), earlier.frame),
        parent_from_site=None,
        clock=of_54.clock - 1e5,
    )
    in_54_m = of_54.site_from_rover.translation_m
    together = read_telemetry([of_53, of_54], [])
    assert together.unplaced == ()
    lsl_from_rover = together.stop(of_54.stop).lsl_from_rover
    assert lsl_from_rover.target == LSL
    declared_m = np.array([-45.1451, -279.261, -0.94907])
    np.testing.assert_allclose(lsl_from_rover.translation_m, in_54_m + declared_m)
    alone = read_telemetry([of_54], [])  # site 53 is not in the traverse: nothing hangs on it
    np.testing.assert_array_equal(alone.stop(of_54.stop).lsl_from_rover.translation_m, in_54_m)
