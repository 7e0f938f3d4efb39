"""Bad files each give one clear line, stop nothing else and lose nothing."""

import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from solmap.flows.simulation import write_downlink
from solmap.photogrammetry.synthetic.scene import WorldParams
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.products.catalogue.workspace import Workspace
from tests.support.hostile_files import compare, label_with
from tests.support.small_downlink import (
    FEW_LAYERS,
    kept,
    write_coarse_pipeline,
    write_small_downlink,
)
from tests.support.store_checks import Contents


@pytest.fixture(scope="module")
def small_world() -> Path:
    world = WorldParams("plains", TraverseParams(stops=1), pairs=1, averaging=4)
    return kept(write_downlink, world, 5)


@pytest.fixture
def downlink(small_world: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(small_world, tmp_path / "downlink"))


@pytest.fixture
def pipeline(tmp_path: Path) -> str:
    return str(write_coarse_pipeline(tmp_path / "coarse.toml", FEW_LAYERS))


def process(downlink: Path, store: Path, pipeline: str):
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - needs the engine's settings

    return process_downlink(downlink, store, pipeline)


def spoil(downlink: Path) -> None:
    good = min(downlink.rglob("*l0m1.img"))
    data = good.read_bytes()
    (downlink / "2n140199999eff1000p1500l0m1.img").write_bytes(data[: len(data) // 2])
    (downlink / "notes.img").write_text("not an image at all\n")
    (downlink / "empty.IMG").write_bytes(b"")
    without_model = data.replace(b"GEOMETRIC_CAMERA_MODEL", b"GEOMETRIC_CAMERA_MADEL")
    (downlink / "2n140188888eff1000p1500l0m1.img").write_bytes(without_model)
    (downlink / "broken.svf").write_text("<rmc_file><solution></rmc_file>")


@pytest.mark.usefixtures("engine")
def test_bad_files_are_named_one_line_each_and_the_rest_is_mapped(downlink, pipeline, tmp_path):
    spoil(downlink)
    report = process(downlink, tmp_path / "store", pipeline)
    assert report.succeeded, report.failures
    lines = {name: line for line in report.warnings for name in bad_names() if name in line}
    assert set(lines) == bad_names()
    assert all("\n" not in line for line in lines.values())
    assert "truncated" in lines["2n140199999eff1000p1500l0m1.img"].lower()
    assert "GEOMETRIC_CAMERA_MODEL" in lines["2n140188888eff1000p1500l0m1.img"]
    kinds = {str(layer.ref.kind) for layer in Workspace.open(tmp_path / "store").catalogue.layers()}
    assert {"dtm", "orthophoto", "stops"} <= kinds


def bad_names() -> set[str]:
    return {
        "2n140199999eff1000p1500l0m1.img",
        "2n140188888eff1000p1500l0m1.img",
        "notes.img",
        "empty.IMG",
        "broken.svf",
    }


@pytest.mark.usefixtures("engine")
def test_earlier_products_survive_a_bad_delivery(downlink, pipeline, tmp_path):
    store = tmp_path / "store"
    process(downlink, store, pipeline)
    before = [layer.ref for layer in Workspace.open(store).catalogue.layers()]
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "notes.img").write_text("not an image\n")
    report = process(bad, store, pipeline)
    assert not report.succeeded
    assert [layer.ref for layer in Workspace.open(store).catalogue.layers()] == before


@pytest.mark.usefixtures("engine")
def test_an_empty_folder_is_reported(pipeline, tmp_path):
    (tmp_path / "nothing").mkdir()
    report = process(tmp_path / "nothing", tmp_path / "store", pipeline)
    assert not report.succeeded
    assert report.failures == [
        f"nothing to process in {tmp_path / 'nothing'}: it holds no image (.img, .png, .jpg) and "
        "no vector file (.svf, .rvf)"
    ]


@pytest.mark.usefixtures("engine")
def test_frames_without_partner_are_mapped_and_named(small_world, pipeline, tmp_path):
    only_left = tmp_path / "left"
    only_left.mkdir()
    left = min(small_world.rglob("*l0m1.img"))
    shutil.copy(left, only_left)
    report = process(only_left, tmp_path / "store", pipeline)
    assert report.succeeded, report.failures
    notes = [note for sol in report.sols for note in sol.notes]
    assert any("is unpaired: no right-eye partner" in note for note in notes)
    layers = Workspace.open(tmp_path / "store").catalogue.layers()
    assert {"footprints", "pointing", "stops"} <= {str(layer.ref.kind) for layer in layers}


@pytest.mark.slow
def test_four_hundred_hostile_files_change_nothing(tmp_path):
    """Each gives one line; products and catalogue are those of the clean run, byte for byte."""
    clean, hostile, wrong = compare(tmp_path)
    assert wrong == []
    assert (clean.code, hostile.code) == (0, 0)
    assert hostile.peak_bytes < 2 << 30
    assert hostile.seconds < 1.5 * clean.seconds


TIMES = (
    *("2004-162T08:00:36.816", "2004-162T08:00:36Z", "2004-06-10T24:00:00", "2004-12-31T23:59:60"),
    *('"UNK"', "UNK", '"N/A"', "NULL", '"unknown"', "2004", "2004-06", "2004-06-10T08"),
)


@pytest.mark.slow
@pytest.mark.usefixtures("engine")
def test_every_legal_time_gives_all_maps(pipeline, tmp_path):
    """Twelve images, each with its times in another form: the products are those of ISO times."""
    plain, odd = write_small_downlink(tmp_path / "plain"), tmp_path / "odd"
    shutil.copytree(plain, odd)
    for file, time in zip(sorted(odd.rglob("*.img")), TIMES, strict=True):
        keywords = ("START_TIME", "STOP_TIME", "PRODUCT_CREATION_TIME", "LOCAL_TRUE_SOLAR_TIME")
        changes = ((keyword, time) for keyword in keywords)
        file.write_bytes(label_with(file.read_bytes(), *changes))
    stores = {}
    for downlink in (plain, odd):
        store = tmp_path / f"{downlink.name}-store"
        report = process(downlink, store, pipeline)
        assert report.succeeded, report.failures
        assert report.warnings == []
        stores[downlink.name] = Contents.of(store)
    kinds = [sorted(key for key in one.rows["latest"]) for one in stores.values()]
    assert kinds[0] == kinds[1]
    starts = {row["start_time"] for row in stores["odd"].rows["images"].values()}
    assert {None, "2004-06-10T08:00:36.816", "2005-01-01T00:00:00.000"} <= starts


def test_a_folder_without_image_files_is_refused_without_an_engine(tmp_path, monkeypatch):
    from solmap.flows.cli import app, processing  # noqa: PLC0415 - slow to import

    monkeypatch.setattr(processing, "engine_of", None)
    folder, root = tmp_path / "downlink", tmp_path / "store"
    folder.mkdir()
    (folder / "notes.img").write_text("not an image at all\n")
    (folder / "empty.IMG").write_bytes(b"")
    ended = CliRunner().invoke(app, ["run", str(folder), "--store", str(root)])
    assert ended.exit_code == 1, ended.output
    failed = f"failed nothing to process in {folder}: none of its 2 files is a mapping image"
    assert failed in ended.output.splitlines()
    outcomes = {one.subject: one.is_failure for one in Workspace.open(root).catalogue.outcomes()}
    assert outcomes == {"notes.img": True, "empty.IMG": True}
