"""What a sol is processed with: without what cannot be read, and without what cannot be true."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solmap.photogrammetry.archive.tables.vector_files import parse_vector_file, vector_text
from solmap.products.catalogue import images as labels
from solmap.products.catalogue.edits import EditKind, EditLog
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import untied_map
from tests.support.hostile_files import label_with
from tests.support.small_downlink import write_small_downlink

OFFSET = re.compile(rb"(ROVER_COORDINATE_SYSTEM.*?ORIGIN_OFFSET_VECTOR\s*= )(\([^)]*\))", re.DOTALL)


@pytest.fixture(scope="module")
def downlink(tmp_path_factory) -> Path:
    return write_small_downlink(tmp_path_factory.mktemp("small"), stops=3, pairs=1)


def files_of(downlink: Path) -> dict[str, bytes]:
    """Its images and vector files."""
    found = [*downlink.rglob("2n*m1.img"), *downlink.rglob("*.?vf")]
    return {file.name: file.read_bytes() for file in found}


def misplace(image: Path, north_m: float) -> bytes:
    """An image whose label places the rover so far north in its site."""
    data = image.read_bytes()
    found = OFFSET.search(data)
    assert found is not None
    vector = f"({north_m:g},0,0)".encode().ljust(len(found[2]))
    return data[: found.start(2)] + vector + data[found.end(2) :]


def take(files: dict[str, bytes], folder: Path, workspace: Workspace) -> None:
    from solmap.tasks.images.ingest import ingest_downlink  # noqa: PLC0415 - imports Prefect

    folder.mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data)
    assert not ingest_downlink.fn(folder, workspace).faults


@pytest.mark.parametrize("sol", [155, 156, 157])
def test_a_stop_five_kilometres_away_has_its_own_map_until_its_labels_are_corrected(
    tmp_path, downlink, sol
):
    from solmap.flows.sol_inputs import assign_maps, gather  # noqa: PLC0415
    from solmap.flows.sols import ReusableSols  # noqa: PLC0415 - imports Prefect

    workspace = Workspace.open(tmp_path / "store")
    true = files_of(downlink)
    wrong = {file.name: misplace(file, 5000.0) for file in downlink.rglob(f"sol0{sol}/*/2n*m1.img")}
    assert len(wrong) == 2
    take({**true, **wrong}, tmp_path / "wrong", workspace)
    drives = {155: (10, 0), 156: (10, 96), 157: (11, 0)}
    alone = untied_map("MER2", *drives[sol])
    assert assign_maps("MER2", workspace) == ["MER2", alone]
    of_wrong = gather(alone, sol, workspace.store.root, "default")
    (stop,) = of_wrong.telemetry.stops
    np.testing.assert_allclose(stop.lsl_from_rover.translation_m, 0.0, atol=1e-9)
    assert of_wrong.landing.name == (
        "origin: site {} drive {}, not tied to the lander".format(*drives[sol])
    )
    keys = ReusableSols.of("MER2", workspace, "default")
    for one in {155, 156, 157} - {sol}:
        inputs = gather("MER2", one, workspace.store.root, "default")
        assert len(inputs.telemetry.stops) == len(
            {155, 156, 157} - {sol} - set(range(one + 1, 158))
        )

    later = {
        name: true[name].replace(b"TIME            = 2004", b"TIME            = 2005")
        for name in wrong
    }
    take(later, tmp_path / "mended", workspace)
    assert assign_maps("MER2", workspace) == ["MER2"]
    assert len(gather("MER2", 157, workspace.store.root, "default").telemetry.stops) == 3
    assert ReusableSols.of("MER2", workspace, "default").images != keys.images


@pytest.mark.parametrize("field", ["ORIGIN_OFFSET_VECTOR", "ORIGIN_ROTATION_QUATERNION"])
def test_one_image_with_a_wrong_rover_position_costs_its_stop_nothing(tmp_path, downlink, field):
    from solmap.flows.sol_inputs import gather  # noqa: PLC0415 - imports Prefect

    workspace = Workspace.open(tmp_path / "store")
    true = files_of(downlink)
    first = min(name for name in true if name.endswith("l0m1.img"))
    wrong = {"ORIGIN_OFFSET_VECTOR": "(50,0,0)", "ORIGIN_ROTATION_QUATERNION": "(0,1,0,0)"}[field]
    name = first.replace(first[2:11], "140100000")  # before all others of its stop
    stray = label_with(
        true[first],
        (f"ROVER_COORDINATE_SYSTEM/{field}", wrong),
        ("SPACECRAFT_CLOCK_START_COUNT", '"140100000.000"'),
        ("PRODUCT_ID", f'"{name[:-4].upper()}"'),
    )
    take({**true, name: stray}, tmp_path / "in", workspace)
    inputs = gather("MER2", 157, workspace.store.root, "default")
    assert len(inputs.telemetry.stops) == 3
    assert len(inputs.images) == 6
    (line,) = gather("MER2", 155, workspace.store.root, "default").unplaced
    assert line.startswith(f"{name[:-4].upper()} is left out: it ")


def test_an_unreadable_image_is_named_and_left_out(tmp_path, downlink, monkeypatch):
    from solmap.flows.sol_inputs import gather  # noqa: PLC0415 - imports Prefect

    workspace = Workspace.open(tmp_path / "store")
    take(files_of(downlink), tmp_path / "in", workspace)
    broken = workspace.catalogue.images("MER2", sol=156)[0]
    workspace.store.path(broken.ref).write_bytes(b"\0" * 100)
    monkeypatch.setattr(labels, "_remembered", {})
    inputs = gather("MER2", 157, workspace.store.root, "default")
    assert list(inputs.unread) == [broken.id]
    assert inputs.unread[broken.id].startswith("LabelError: ")
    assert len(inputs.images) == 5
    assert len(inputs.telemetry.stops) == 3


def moved(svf: bytes) -> bytes:
    """A site vector file that has site 10 elsewhere."""
    file = parse_vector_file(svf.decode(), "master.svf")
    solutions = [
        replace(one, offset_m=np.array([100.0, 50.0, 1.0])) if one.counter == (10,) else one
        for one in file.solutions
    ]
    return vector_text(replace(file, solutions=tuple(solutions))).encode()


def test_annotations_move_with_the_map_to_mars(tmp_path, downlink):
    from solmap.flows.sol_inputs import assign_maps, read_map  # noqa: PLC0415 - imports Prefect

    workspace = Workspace.open(tmp_path / "store")
    true = files_of(downlink)
    vectors = {name: moved(data) for name, data in true.items() if name.endswith("svf")}
    take({k: v for k, v in true.items() if not k.endswith("vf")}, tmp_path / "images", workspace)
    old = untied_map("MER2", 10)
    assert old in assign_maps("MER2", workspace)
    before = read_map(old, workspace).telemetry.stops[0].lsl_from_rover.translation_m
    edits = EditLog.of(workspace.store.root)
    ring = [[1.0, 2.0], [3.0, 2.0], [3.0, 4.0], [1.0, 2.0]]
    rock = {"type": "Point", "coordinates": [5.0, 7.0, 0.5]}
    edits.append(old, EditKind.ANNOTATION, {"geometry": rock, "text": "rock"}, "ann", "look")
    area = {"type": "Polygon", "coordinates": [ring]}
    edits.append(old, EditKind.ANNOTATION, {"geometry": area, "text": "area"}, "ben")
    gone = edits.append(old, EditKind.ANNOTATION, {"geometry": rock, "text": "slip"}, "ben")
    edits.undo(old, gone.id, "ben")
    edits.append(old, EditKind.TIE, {"action": "veto"}, "ann")
    take(vectors, tmp_path / "vectors", workspace)
    for _ in range(2):
        assert assign_maps("MER2", workspace) == ["MER2"]
    after = read_map("MER2", workspace).telemetry.stops[0].lsl_from_rover.translation_m
    north, east, down = after - before
    assert (north, east, down) == pytest.approx((100.0, 50.0, 1.0))
    assert [edit.counts for edit in edits.edits(old) if edit.kind is not EditKind.UNDO] == [
        False
    ] * 4
    rock, area = edits.effective(EditKind.ANNOTATION, "MER2")
    assert (rock.document["text"], rock.author, rock.note) == ("rock", "ann", "look")
    places = [rock.document["geometry"]["coordinates"][:2]]
    places += area.document["geometry"]["coordinates"][0]
    np.testing.assert_allclose(np.array(places) - [east, north], [[5.0, 7.0], *ring])
    assert rock.document["geometry"]["coordinates"][2] == pytest.approx(0.5 - down)
    (tie,) = edits.effective(EditKind.TIE, "MER2")
    assert tie.document == {"action": "veto"}
