"""Poses by other sources: taken as priors with a deviation and a source, and given to images."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.datum import with_control
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.archive.labels.detached import join_label
from solmap.photogrammetry.archive.tables.places import LOCALISED
from solmap.photogrammetry.archive.tables.vector_files import (
    Solution,
    VectorFile,
    parse_vector_file,
    vector_text,
)
from solmap.photogrammetry.errors import VectorFileError
from solmap.photogrammetry.frames import (
    LSL,
    FrameKind,
    FrameTree,
    Pose,
    quaternion_of_rotation,
    rotation_of_roll_pitch_yaw,
    site_frame,
)
from solmap.photogrammetry.synthetic.networks import simulate_network
from solmap.products.catalogue.images import image_record
from solmap.products.catalogue.workspace import Workspace
from solmap.tasks.images.poses import PoseSources, open_pose_sources, take_poses
from solmap.tasks.images.telemetry import (
    LOCALISED_SIGMA_M,
    read_telemetry,
    stated_poses,
    vector_files,
)
from tests.support.spice_kernels import write_kernels
from tests.unit.adjustment.modes.test_control import errors, without_ties_across

M2020 = "NLF_0670_0726421423_362ECM_N0320604NCAM08111_01_095J01"
IMAGE = "NLF_0670_0726421423_362ECM_N0320604NCAM08111_01_095J"
ATTITUDE = quaternion_of_rotation(rotation_of_roll_pitch_yaw(*np.radians([1.0, -2.0, 75.0])))
HEADER = "image,site,drive,reference_site,x_m,y_m,z_m,qw,qx,qy,qz,sigma_m,sigma_deg,source\n"
PLACES = "frame,site,drive,landing_x,landing_y,landing_z,quat_s,quat_v1,quat_v2,quat_v3\n"
WORDS = ",".join(map(repr, ATTITUDE.tolist()))


@pytest.fixture
def workspace(tmp_path):
    return Workspace.open(tmp_path / "store")


@pytest.fixture
def bare(shared_data, tmp_path):
    """The one available raw image of Perseverance, without attitude."""
    folder = tmp_path / "bare"
    folder.mkdir()
    for file in shared_data.rglob(f"{M2020}*"):
        (folder / file.name).write_bytes(file.read_bytes())
    return folder


@pytest.fixture
def spirit(shared_data, tmp_path):
    """Two frames of Spirit at one stop."""
    folder = tmp_path / "spirit"
    folder.mkdir()
    for file in (shared_data / "mer_spirit_sol1869_troy").glob("*effb*.img"):
        (folder / file.name).write_bytes(file.read_bytes())
    return folder


def ingested(folder, workspace, *files):
    from solmap.tasks.images.ingest import ingest_downlink  # noqa: PLC0415 - imports Prefect

    with open_pose_sources(files) as poses:
        return ingest_downlink.fn(folder, workspace, poses=poses)


def of(text, path):
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("by_stop.csv", f"{HEADER},32,604,0,900,-40,2,{WORDS},0.5,,\n"),
        ("by_image.csv", f"{HEADER}{IMAGE}.png,,,,900,-40,2,{WORDS},0.5,,\n"),
        ("places.csv", f"{PLACES}ROVER,32,604,900,-40,2,{WORDS}\n"),
    ],
)
def test_an_image_without_attitude_is_used_with_a_stated_one(bare, workspace, tmp_path, name, text):
    (fault,) = ingested(bare, workspace).faults
    assert "`solmap run FOLDER --places FILE`" in fault.notes[0]
    delivery = ingested(bare, workspace, of(text, tmp_path / name))
    assert not delivery.faults
    (entry,) = workspace.catalogue.images("M20")
    pose = image_record(entry, workspace).site_from_rover
    np.testing.assert_allclose(pose.quaternion, ATTITUDE, atol=1e-9)
    assert pose.translation_m.tolist() == [12.8213, 60.1509, 0.32331]  # as in its metadata


def test_an_rvf_in_the_folder_places_an_image_too(bare, workspace, tmp_path):
    table = of(f"{PLACES}ROVER,32,604,900,-40,2,{WORDS}\n", tmp_path / "places.csv")
    with open_pose_sources([table]) as poses:
        file = poses.tables[0].stated
    rvf = vector_text(file).replace('mission=""', 'mission="M2020"')
    of(rvf, bare / "site.rvf")
    assert not ingested(bare, workspace).faults


def test_a_corrected_attitude_counts(bare, workspace, tmp_path):
    for degrees in (10.0, 20.0, 15.0):
        half = math.radians(degrees) / 2
        row = f",32,604,0,0,0,0,{math.cos(half)!r},0,0,{math.sin(half)!r},,,\n"
        ingested(bare, workspace, of(HEADER + row, tmp_path / "poses.csv"))
        (entry,) = workspace.catalogue.images("M20")
        w, *_, z = image_record(entry, workspace).site_from_rover.quaternion
        assert np.degrees(2 * np.arctan2(z, w)) == pytest.approx(degrees)


def test_poses_are_priors_with_deviation_and_source(spirit, workspace, tmp_path):
    """In the network as observations, in frames named after the files."""
    ingested(spirit, workspace)
    entry, *_ = workspace.catalogue.images("MER2")
    label = image_record(entry, workspace)
    stop, site = label.stop, label.stop.site
    rows = f"{HEADER}{entry.id},,,0,3000,-500,20,{WORDS},0.25,0.5,survey\n"
    rows += f",{site},99999,,1,2,3,,,,,,,\n"
    near = f"frame,site,drive,landing_x,landing_y,landing_z\nSITE,{site},-1,2990,-480,19\n"
    files = [of(rows, tmp_path / "poses.csv"), of(near, tmp_path / "places.csv")]
    with open_pose_sources(files) as sources:
        lines = take_poses(sources, "MER2", workspace)
    assert lines[0].startswith("poses.csv: 1 sites and stops")
    assert f"poses.csv, row 2: no image of mer2-site{site:04d}-drive99999 is in" in lines[1]
    read = read_telemetry([label], vector_files("MER2", workspace))
    (known,) = read.stops
    assert read.origins[site] == 0
    ((frame, (control,)),) = read.stated
    assert (control.stop, control.frame, frame.name) == (stop, "poses-csv", "poses-csv")
    assert (control.east_m, control.north_m, control.up_m) == (-500.0, 3000.0, -20.0)
    sigmas = np.sqrt(np.diagonal(control.covariance))
    np.testing.assert_allclose(sigmas, [0.25, 0.25, 0.25, np.radians(0.5)])
    assert control.azimuth_deg == pytest.approx(75.0)
    assert read.sigma_from_origin_m(stop, 0.1) == pytest.approx(
        np.hypot(LOCALISED_SIGMA_M, 0.1 * np.linalg.norm(label.site_from_rover.translation_m))
    )
    assert known.lsl_from_rover.translation_m[0] == pytest.approx(
        2990 + label.site_from_rover.translation_m[0]
    )


def test_stated_poses_bridge_a_gap_in_the_ties_in_any_frame():
    """Good to 0.25 m in a frame that lies 47 m off and is turned by 1.7 degrees."""
    lander = FrameTree().with_poses([Pose.identity(LSL, site_frame(0))])
    turn = rotation_of_roll_pitch_yaw(0.0, 0.0, 0.03)
    off_m = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        network, truth = simulate_network(
            rng, stops=8, pairs_per_stop=5, inter_ties=8, intra_ties=0
        )
        network = without_ties_across(network, 3)
        solutions = []
        for true in truth.lsl_from_rover:
            place_m = turn @ true.translation_m + [40.0, -25.0, 3.0] + rng.normal(0.0, 0.25, 3)
            stop = FrameKind.ROVER, true.source.index, 0
            solutions.append(Solution(LOCALISED, *stop, place_m, true.quaternion, "", 0.25))
        file = VectorFile("poses-csv", "TEST", "rvf", (), tuple(solutions))
        ((frame, control),) = stated_poses([file], network.stop_ids, lander)
        params = AdjustmentParams()
        (found, _), (without, _) = (
            adjust_overall(one, params)
            for one in (with_control(network, [frame], control, params), network)
        )
        assert "control: its position in poses-csv" in found.stops[3].held_by
        assert all(one.used for one in found.control)
        off_m.append([np.hypot(*errors(one, truth)[-1, 3:5]) for one in (found, without)])
    with_poses_m, without_m = np.median(off_m, axis=0)
    assert with_poses_m < 1.0
    assert without_m > 2.0


def test_a_file_delivered_again_under_its_name_replaces_the_first(spirit, workspace, tmp_path):
    ingested(spirit, workspace)
    entry, *_ = workspace.catalogue.images("MER2")
    for north in (1.0, 2.0):
        file = of(f"{HEADER}{entry.id},,,0,{north},0,0,,,,,,,\n", tmp_path / "poses.csv")
        with open_pose_sources([file]) as sources:
            take_poses(sources, "MER2", workspace)
    (file,) = vector_files("MER2", workspace)
    (solution,) = file.solutions
    assert solution.offset_m[0] == 2.0
    np.testing.assert_allclose(  # not stated: as the label has it
        solution.pose.rotation, image_record(entry, workspace).site_from_rover.rotation, atol=1e-9
    )


def test_spice_kernels_give_the_pose_of_every_stop_they_cover(spirit, workspace, tmp_path):
    pytest.importorskip("spiceypy", reason="the optional extra `spice` is not installed")
    ingested(spirit, workspace)
    entry, *_ = workspace.catalogue.images("MER2")
    label = image_record(entry, workspace)
    place_m = np.array([-300.0, 1500.0, -80.0])
    attitude = rotation_of_roll_pitch_yaw(0.05, -0.02, 1.0)
    kernels = write_kernels(tmp_path, place_m, attitude, clock=label.clock)
    with open_pose_sources(kernels) as sources:
        (line,) = take_poses(sources, "MER2", workspace)
        with pytest.raises(VectorFileError, match="cover none of the 0 stops of MER1"):
            take_poses(sources, "MER1", workspace)
    assert line.startswith("spice-mer2: 1 sites and stops")
    read = read_telemetry([label], vector_files("MER2", workspace))
    (known,) = read.stops  # the site is tied by the kernels alone
    np.testing.assert_allclose(known.lsl_from_rover.translation_m, place_m, atol=1e-6)
    np.testing.assert_allclose(known.lsl_from_rover.rotation, attitude, atol=1e-8)
    ((frame, _),) = read.stated
    assert frame.name == "spice-mer2"
    assert read.sigma_from_origin_m(label.stop, 0.1) == LOCALISED_SIGMA_M


def test_standard_deviations_are_kept_in_the_vector_file(tmp_path):
    table = of(f"{PLACES}ROVER,3,4,900,-40,2,{WORDS}\n", tmp_path / "places.csv")
    with open_pose_sources([table]) as poses:
        file = poses.tables[0].stated
    stated = replace(file.solutions[0], sigma_m=0.5, sigma_deg=0.25)
    text = vector_text(replace(file, mission="MSL", solutions=(stated,)))
    (back,) = parse_vector_file(text, "x").solutions
    assert (back.sigma_m, back.sigma_deg) == (0.5, 0.25)
    with pytest.raises(VectorFileError, match=r"sigma_m of .* should be above 0"):
        parse_vector_file(text.replace('sigma_m="0.5"', 'sigma_m="-1"'), "x")


def test_a_label_with_attitude_is_kept_byte_for_byte(shared_data):
    metadata = json.loads(next(shared_data.rglob(f"{M2020}-metadata.json")).read_text())
    text = json.dumps(metadata | {"attitude": [1, 0, 0, 0]})
    data = join_label(text.encode(), b"\x89PNG", "x")
    assert PoseSources().with_attitude(data, "x") is data
    assert PoseSources().with_attitude(b"PDS_VERSION_ID", "x") == b"PDS_VERSION_ID"


def test_a_file_of_unknown_kind_is_refused_by_name(tmp_path):
    file = of("east,north\n1,2\n", tmp_path / "notes.csv")
    with (
        pytest.raises(VectorFileError, match=r"notes\.csv: not a PLACES table"),
        open_pose_sources([file]),
    ):
        pass
