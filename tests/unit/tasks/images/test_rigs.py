"""Pairs of an own stereo rig are ingested, and a fault is reported in one line."""

import os
import shutil

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.archive.partners import find_stereo_pairs
from solmap.photogrammetry.cameras.calibrated import BrownConrady
from solmap.products.catalogue.images import image_file, image_records, read_product_image
from solmap.products.catalogue.workspace import Workspace
from solmap.tasks.images.ingest import ingest_downlink
from tests.support.field_rig import rig_text

SIZE = (96, 64)
POSES = "image,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg,sigma_m\n{rows}"


@pytest.fixture
def folder(tmp_path, rng):
    """Two pairs of noise with their rig and poses."""
    folder = tmp_path / "drive"
    for eye in ("left", "right"):
        (folder / eye).mkdir(parents=True)
        for number in (1, 2):
            image = rng.integers(1, 255, SIZE[::-1]).astype(np.uint8)
            cv2.imwrite(str(folder / eye / f"{number:04d}.png"), image)
    (folder / "rig.toml").write_text(rig_text(size=SIZE))
    rows = "0001.png,0,0,0,0,0,0,\n0002.png,0.8,0.1,0,0,0,5,\n"
    (folder / "poses.csv").write_text(POSES.format(rows=rows))
    return folder


@pytest.fixture
def workspace(tmp_path):
    return Workspace.open(tmp_path / "store")


def notes_of(delivery):
    return [note for fault in delivery.faults for note in fault.notes]


def test_pairs_are_ingested_with_camera_and_pose(folder, workspace):
    delivery = ingest_downlink.fn(folder, workspace)
    assert notes_of(delivery) == []
    assert delivery.missions == ("FIELD",)
    entries = workspace.catalogue.images("FIELD")
    assert sorted(entry.id for entry in entries) == [
        f"FIELD_S000_000{n}-{eye}" for n in (1, 2) for eye in "LR"
    ]
    records = image_records(entries, workspace)
    assert len(find_stereo_pairs(records).pairs) == 2
    second = next(record for record in records if record.stop.drive == 2)
    assert isinstance(second.camera, BrownConrady)
    np.testing.assert_allclose(second.site_from_rover.translation_m, [0.8, 0.1, 0.0])
    read = read_product_image(image_file(entries[0]), workspace.store)
    expected = cv2.imread(str(folder / "left" / "0001.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read.pixels, expected)


def test_a_copied_folder_changes_nothing_and_a_new_calibration_counts(folder, workspace, tmp_path):
    ingest_downlink.fn(folder, workspace)
    before = {entry.id: entry.ref for entry in workspace.catalogue.images()}
    copy = shutil.copytree(folder, tmp_path / "copy")
    for file in copy.rglob("*.*"):
        os.utime(file, (2e9, 2e9))  # a copy with a later date
    ingest_downlink.fn(copy, workspace)
    assert {entry.id: entry.ref for entry in workspace.catalogue.images()} == before
    text = (copy / "rig.toml").read_text()
    (copy / "rig.toml").write_text(text.replace("pitch_deg = -22.0", "pitch_deg = -20.0"))
    os.utime(copy / "rig.toml", (2.1e9, 2.1e9))
    assert notes_of(ingest_downlink.fn(copy, workspace)) == []
    after = {entry.id: entry.ref for entry in workspace.catalogue.images()}
    assert all(after[name] != before[name] for name in before)


def test_without_poses_every_pair_but_the_first_has_a_separate_site(folder, workspace):
    (folder / "poses.csv").unlink()
    ingest_downlink.fn(folder, workspace)
    sites = {(entry.site, entry.drive) for entry in workspace.catalogue.images()}
    assert sites == {(0, 1), (1, 2)}


def _resize(folder):
    cv2.imwrite(str(folder / "left" / "0002.png"), np.full((48, 64), 9, np.uint8))


@pytest.mark.parametrize(
    ("spoil", "messages", "taken"),
    [
        (
            lambda folder: (folder / "right" / "0002.png").unlink(),
            ["left/0002.png: its partner right/0002.png is missing; deliver both images"],
            2,
        ),
        (
            _resize,
            ["0002.png: 64 x 48 pixels, but its camera in rig.toml is calibrated for 96 x 64"],
            3,
        ),
        (
            lambda folder: (folder / "rig.toml").write_text(
                rig_text().replace('model = "brown-conrady"', 'model = "mei"')
            ),
            ["rig.toml: [left]: the camera model 'mei' is not known; calibrate with one of"],
            0,
        ),
        (
            lambda folder: (folder / "rig.toml").write_text(
                'mission = "FIELD"\ncalibration = "lost.yaml"\n'
                '[left]\nimages = "left/*.png"\n[right]\nimages = "right/*.png"\n'
            ),
            [
                "lost.yaml cannot be read: No such file or directory; it should be in "
                "the folder of rig.toml"
            ],
            0,
        ),
        (
            lambda folder: (folder / "poses.csv").write_text(POSES.format(rows="1,2,3\n")),
            ["rig.toml: poses.csv, row 1"],
            0,
        ),
        (
            lambda folder: (folder / "poses.csv").write_text(
                POSES.format(rows="0001,0,0,0,0,0,0,\n")
            ),
            ["left/0002.png: no row of the poses CSV matches it", "right/0002.png: no row"],
            2,
        ),
        (
            lambda folder: (folder / "readme.png").write_bytes(b"\x89PNG\r\n\x1a\n"),
            ["readme.png: its name is neither left/*.png nor right/*.png of rig.toml"],
            4,
        ),
        (
            lambda folder: (folder / "left" / "0002.png").write_bytes(b"no picture"),
            ["0002.png: neither a PNG nor a JPEG image"],
            3,
        ),
    ],
    ids=["partner", "size", "model", "calibration", "poses", "row", "other", "broken"],
)
def test_faults_are_reported_in_one_line_and_the_rest_continues(
    spoil, messages, taken, folder, workspace
):
    spoil(folder)
    delivery = ingest_downlink.fn(folder, workspace)
    notes = notes_of(delivery)
    assert len(notes) == len(messages)
    for note, message in zip(sorted(notes), messages, strict=True):
        assert message in note
        assert "\n" not in note
    assert len(workspace.catalogue.images()) == taken


def test_names_may_not_leave_the_folder(folder, workspace, tmp_path):
    (tmp_path / "secret.yaml").write_text("camera_matrix: 1")
    text = 'mission = "FIELD"\ncalibration = "../secret.yaml"\n'
    text += '[left]\nimages = "left/*.png"\n[right]\nimages = "right/*.png"\n'
    (folder / "rig.toml").write_text(text)
    (note,) = notes_of(ingest_downlink.fn(folder, workspace))
    assert "../secret.yaml should be in the folder of rig.toml or below it" in note
