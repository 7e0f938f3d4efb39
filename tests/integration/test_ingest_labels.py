"""Labels on their way through ingestion: in files of their own, and as links between sites."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.archive.images.reading import (
    ReadImage,
    read_image,
    read_image_record,
)
from solmap.photogrammetry.archive.labels.detached import split_label
from solmap.photogrammetry.frames import LSL, Pose, site_frame
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.synthetic.scene import WorldParams
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.products.catalogue.images import image_file, image_record, read_product_image
from solmap.products.catalogue.workspace import Workspace
from solmap.tasks.images.ingest import Delivery, ingest_downlink
from solmap.tasks.images.telemetry import read_telemetry
from tests.support.small_downlink import rendered_images, write_coarse_pipeline

MSL = "NLB_517261274EDR_F0541610CCAM15900M1"
M2020 = "NLF_0670_0726421423_362ECM_N0320604NCAM08111_01_095J01"
TILE = "NLF_0629_0722782785_631ECM_N0301344NCAM00427_06_095J01"
PDS4 = Path(__file__).parents[1] / "unit" / "archive" / "labels" / "navcam_of_perseverance.xml"


def ingested(downlink: Path, workspace: Workspace) -> Delivery:
    return ingest_downlink.fn(downlink, workspace)


@pytest.fixture
def downlink(tmp_path) -> Path:
    folder = tmp_path / "downlink"
    folder.mkdir()
    return folder


@pytest.fixture
def workspace(tmp_path) -> Workspace:
    return Workspace.open(tmp_path / "store")


def test_an_image_with_a_detached_label_is_ingested(shared_data, downlink, workspace):
    path = next(shared_data.rglob(f"{MSL}.IMG"))
    label = path.with_suffix(".LBL").read_text("latin-1")
    record = label.index(",23)")
    label = label[:record] + ",1)" + label[record + 4 :]
    pixels = path.read_bytes()[-1024 * 1024 * 2 :]
    (downlink / f"{MSL}.IMG").write_bytes(pixels)
    (downlink / f"{MSL}.LBL").write_text(label)
    delivery = ingested(downlink, workspace)
    assert not delivery.faults
    (entry,) = workspace.catalogue.images()
    assert entry.id == MSL
    kept = workspace.store.path(entry.ref).read_bytes()
    assert split_label(kept, entry.id) == (label.encode(), pixels)
    np.testing.assert_array_equal(
        read_product_image(image_file(entry), workspace.store).pixels,
        read_image(path.read_bytes(), path.name).pixels,
    )
    assert image_record(entry, workspace).stop == delivery.images[0].stop


def test_an_image_with_an_attached_label_is_kept_unchanged(shared_data, downlink, workspace):
    path = next(shared_data.rglob(f"{MSL}.IMG"))
    (downlink / path.name).write_bytes(path.read_bytes())
    (downlink / f"{MSL}.LBL").write_text("no label at all")
    (downlink / f"{MSL}.xml").write_text("no label at all")
    assert not ingested(downlink, workspace).faults
    (entry,) = workspace.catalogue.images()
    assert workspace.store.path(entry.ref).read_bytes() == path.read_bytes()


def test_curiosity_s_files_are_ingested_as_archived(shared_data, downlink, workspace):
    """EDR and RDR, each an .IMG with a label of its own and an equal .LBL."""
    folder = shared_data / "msl_navcam_sol1431_pair"
    for path in [*folder.glob("*.IMG"), *folder.glob("*.LBL")]:
        (downlink / path.name).write_bytes(path.read_bytes())
    assert not ingested(downlink, workspace).faults
    left, right = workspace.catalogue.images("MSL")
    assert (left.site, left.drive, left.eye, left.sol) == (54, 1610, "left", 1349)
    assert (right.site, right.drive, right.eye, right.sol) == (90, 232, "right", 3192)


def test_a_pds4_label_is_kept_with_its_data_and_read_from_there(downlink, workspace, rng):
    data = bytes(16) + rng.integers(1, 255, (3, 2, 3), dtype=np.uint8).tobytes()
    (downlink / f"{TILE}.IMG").write_bytes(data)
    (downlink / f"{TILE}.xml").write_bytes(PDS4.read_bytes())
    assert not ingested(downlink, workspace).faults
    (entry,) = workspace.catalogue.images("M20")
    assert (entry.id, entry.site, entry.drive, entry.product_type) == (TILE, 30, 1344, "ECM")
    kept = workspace.store.path(entry.ref).read_bytes()
    assert split_label(kept, entry.id) == (PDS4.read_bytes(), data)
    record = image_record(entry, workspace)
    assert record.parent_from_site is not None
    assert (record.lines, record.samples) == (2, 3)


def metadata(shared_data: Path, **changes: object) -> bytes:
    text = next(shared_data.rglob(f"{M2020}-metadata.json")).read_text()
    return json.dumps({**json.loads(text), **changes}).encode()


def test_a_raw_image_of_mars_2020_is_kept_with_its_metadata(shared_data, downlink, workspace):
    png = next(shared_data.rglob(f"{M2020}.png")).read_bytes()
    message = metadata(shared_data, attitude="(0.8,0.0,0.0,0.6)")
    (downlink / f"{M2020}.png").write_bytes(png)
    (downlink / f"{M2020}-metadata.json").write_bytes(message)
    assert not ingested(downlink, workspace).faults
    (entry,) = workspace.catalogue.images("M20")
    assert (entry.sol, entry.site, entry.drive, entry.instrument) == (670, 32, 604, "NAVCAM")
    assert split_label(workspace.store.path(entry.ref).read_bytes(), entry.id) == (message, png)
    read = read_product_image(image_file(entry), workspace.store)
    colour = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_allclose(read.pixels[read.mask], colour.mean(axis=2)[read.mask], atol=1e-4)
    assert read.mask.mean() > 0.99


def test_a_jpeg_may_have_a_detached_label(shared_data, downlink, workspace):
    path = next(shared_data.rglob(f"{MSL}.IMG"))
    grey = (read_image(path.read_bytes(), path.name).pixels / 16).clip(1, 255).astype(np.uint8)
    (downlink / f"{MSL}.JPG").write_bytes(cv2.imencode(".jpg", grey)[1].tobytes())
    (downlink / f"{MSL}.LBL").write_bytes(path.with_suffix(".LBL").read_bytes())
    assert not ingested(downlink, workspace).faults
    (entry,) = workspace.catalogue.images("MSL")
    read = read_product_image(image_file(entry), workspace.store)
    assert np.abs(read.pixels - grey).mean() < 2  # of JPEG at OpenCV's quality of 95


def test_a_file_that_cannot_be_placed_is_one_line_and_the_rest_continues(
    shared_data, downlink, workspace
):
    png = next(shared_data.rglob(f"{M2020}.png")).read_bytes()
    cases = {
        "without_attitude": metadata(shared_data),
        "without_model": metadata(shared_data, camera_model_type="UNK"),
        "of_another_size": metadata(shared_data, attitude="(1,0,0,0)", dimension="(1280,960)"),
        "thumbnail": metadata(shared_data, attitude="(1,0,0,0)", sample_type="Thumbnail"),
        "without_metadata": None,
    }
    for name, message in cases.items():
        (downlink / f"{name}.png").write_bytes(png)
        if message is not None:
            (downlink / f"{name}-metadata.json").write_bytes(message)
    good = next(shared_data.rglob(f"{MSL}.IMG"))
    (downlink / good.name).write_bytes(good.read_bytes())
    (downlink / f"{MSL}.PNG").write_bytes(png)  # its browse images, by name
    (downlink / f"{MSL}.IMG.JPG").write_bytes(png)
    delivery = ingested(downlink, workspace)
    assert [image.id for image in delivery.images] == [MSL]
    lines = {fault.subject: fault.notes for fault in delivery.faults}
    assert set(lines) == {f"{name}.png" for name in cases}
    for name, message_ in {
        "without_attitude": "no attitude of the rover; give its pose",
        "without_model": "camera_model_type should be CAHV, CAHVOR or CAHVORE",
        "of_another_size": "image is 1288 x 968 pixels, its label has 1280 x 960",
        "thumbnail": "not a mapping image: sample_type is 'Thumbnail'",
        "without_metadata": "an image without a label; without_metadata-metadata.json",
    }.items():
        (line,) = lines[f"{name}.png"]
        assert line.startswith(f"{name}.png: ")
        assert message_ in line
        assert "\n" not in line


def test_a_file_delivered_again_intact_is_no_longer_a_fault(downlink, workspace, rng):
    data = bytes(16) + rng.integers(1, 255, (3, 2, 3), dtype=np.uint8).tobytes()
    (downlink / f"{TILE}.xml").write_bytes(PDS4.read_bytes())
    (downlink / f"{TILE}.IMG").write_bytes(data[:20])
    assert len(ingested(downlink, workspace).faults) == 1
    (downlink / f"{TILE}.IMG").write_bytes(data)
    assert not ingested(downlink, workspace).faults
    (outcome,) = workspace.catalogue.outcomes()
    assert (outcome.subject, outcome.is_failure, outcome.notes) == (f"{TILE}.IMG", False, ())


def raw_of_mars_2020(read: ReadImage, folder: Path) -> None:
    """An image as the public site has those of Perseverance: eight bits, and JSON beside it."""
    image, camera = read.image, read.image.camera
    letters = (camera.c, camera.a, camera.h, camera.v, camera.o, camera.r)
    pose = image.site_from_rover

    def text(values) -> str:
        return "(" + ",".join(f"{value:.9g}" for value in values) + ")"

    name = f"N{image.eye[0].upper()}F_0005_{int(image.clock):010d}_000ECM_N0010000NCAM00001_01_095J"
    message = {
        "imageid": name,
        "sol": image.sol,
        "instrument": f"NAVCAM_{image.eye.upper()}",
        "sclk": image.clock,
        "dimension": f"({image.samples},{image.lines})",
        "site": image.stop.site,
        "drive": str(image.stop.drive),
        "xyz": text(pose.translation_m),
        "attitude": text(pose.quaternion),
        "camera_model_type": "CAHVOR",
        "camera_model_component_list": ";".join(text(vector) for vector in letters),
    }
    (folder / f"{name}01-metadata.json").write_text(json.dumps(message))
    eight_bits = (read.pixels / 16).clip(1, 255).round().astype(np.uint8)
    cv2.imwrite(str(folder / f"{name}01.png"), eight_bits)


@pytest.mark.usefixtures("engine")
def test_raw_images_with_metadata_are_mapped(shared_data, downlink, tmp_path):
    """Through the whole pipeline, among images that cannot be placed."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - needs the engine's settings

    world = WorldParams("plains", TraverseParams(stops=1), pairs=1, averaging=4)
    for file in rendered_images(world, 21):
        raw_of_mars_2020(read_image(file.data, Path(file.path).name), downlink)
    real = next(shared_data.rglob(f"{M2020}.png"))
    (downlink / real.name).write_bytes(real.read_bytes())
    (downlink / f"{M2020}-metadata.json").write_bytes(metadata(shared_data))
    (downlink / "selfie.jpg").write_bytes(cv2.imencode(".jpg", np.ones((9, 9), np.uint8))[1])
    pipeline = write_coarse_pipeline(tmp_path / "coarse.toml")
    report = process_downlink(downlink, tmp_path / "store", str(pipeline))
    assert report.succeeded, report.failures
    named = [line.partition(":")[0] for line in report.warnings]
    assert named[:2] == [real.name, "selfie.jpg"]  # then the note on where the LSL starts
    workspace = Workspace.open(tmp_path / "store")
    (untied,) = workspace.catalogue.maps_of("M20")
    left, right = workspace.catalogue.images(untied)
    assert (left.partner, right.partner) == (right.id, left.id)
    kinds = {str(layer.ref.kind) for layer in workspace.catalogue.layers(untied)}
    assert {"dtm", "orthophoto", "footprints", "stops"} <= kinds


def test_labels_that_place_their_site_join_the_stops_of_two_sites(shared_data):
    """Without a vector file: site 54 is placed in site 53 by its label."""
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
    assert not together.unplaced
    lsl_from_rover = together.stop(of_54.stop).lsl_from_rover
    assert lsl_from_rover.target == LSL
    declared_m = np.array([-45.1451, -279.261, -0.94907])
    np.testing.assert_allclose(lsl_from_rover.translation_m, in_54_m + declared_m)
    alone = read_telemetry(
        [of_54], []
    )  # site 53 is not in the traverse: nothing is connected to it
    np.testing.assert_array_equal(alone.stop(of_54.stop).lsl_from_rover.translation_m, in_54_m)


def test_of_two_files_of_an_image_the_later_edition_counts_in_any_order(tmp_path):
    world = WorldParams("plains", TraverseParams(stops=1), pairs=1, averaging=4)
    file = next(f for f in rendered_images(world, 21) if f.path.endswith("l0m1.img"))
    made = re.search(rb"PRODUCT_CREATION_TIME\s*= (\d{4})", file.data)
    later = file.data[: made.start(1)] + b"2039" + file.data[made.end(1) :]
    twin = file.data[:-1] + bytes([file.data[-1] ^ 1])  # made at the same time, another content
    contents = {"file": file.data, "later": later, "twin": twin}

    def kept(*deliveries: tuple[str, ...]) -> tuple[bytes, int]:
        name = "-".join("+".join(delivery) for delivery in deliveries)
        workspace, aside = Workspace.open(tmp_path / name / "store"), 0
        for number, delivery in enumerate(deliveries):
            for what in delivery:
                path = tmp_path / name / str(number) / what / Path(file.path).name
                path.parent.mkdir(parents=True)
                path.write_bytes(contents[what])
            faults = ingested(tmp_path / name / str(number), workspace).faults
            assert all("was made later and is used instead" in fault.notes[0] for fault in faults)
            assert not any(fault.is_failure for fault in faults)
            aside += len(faults)
        (entry,) = workspace.catalogue.images()
        return workspace.store.path(entry.ref).read_bytes(), aside

    assert kept(("file",), ("later",)) == (later, 0)
    assert kept(("later",), ("file",)) == (later, 1)
    assert kept(("file", "later", "twin")) == (later, 2)
    assert kept(("file",), ("file",)) == (file.data, 0)
    assert kept(("file",), ("twin",))[0] == kept(("twin",), ("file",))[0]
