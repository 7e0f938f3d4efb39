"""Tables and flat fields on their way from the settings to every pixel that is read."""

import json
import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from solmap.config.radiometry import load_radiometry
from solmap.flows.cli import app
from solmap.photogrammetry.archive.images.radiometry import RadialVignetting
from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.stretching import stretch
from solmap.photogrammetry.synthetic.downlink import text_files
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.products.catalogue.images import image_file, read_product_image
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, Recipe
from solmap.tasks.images.ingest import ingest_downlink
from solmap.tasks.images.pairs import pairs_of, read_pair
from solmap.tasks.network.match import MatchParams, match_stereo_pair
from solmap.tasks.scopes import pair_scope
from tests.support.small_downlink import FEW_LAYERS, rendered_images, write_coarse_pipeline

COUNTS = np.round(4095 * (np.arange(256) / 255) ** 1.9).astype(int)
"""A table that is not among the built-in ones."""
MODEL = RadialVignetting(k1=-0.25)
SIDE = 256


@dataclass(frozen=True)
class Frames:
    """The two files of a stereo pair, by name, and what a table makes of their pixels."""

    files: dict[str, bytes]
    texts: dict[str, bytes]

    def coded(self, counts: np.ndarray) -> "Frames":
        """The same frames squeezed into 8 bits by the inverse of a table, and labelled so."""
        return Frames({name: coded(data, counts) for name, data in self.files.items()}, self.texts)

    def written(self, folder: Path) -> Path:
        folder.mkdir()
        for name, data in {**self.files, **self.texts}.items():
            (folder / name).write_bytes(data)
        return folder


@pytest.fixture(scope="module")
def frames() -> Frames:
    params = WorldParams("plains", TraverseParams(stops=1), pairs=1, averaging=4)
    world, files = make_world(params, 21), rendered_images(params, 21)
    texts = {Path(f.path).name: f.data for f in text_files(world) if f.path.endswith("vf")}
    return Frames({Path(f.path).name: f.data for f in files}, texts)


def stored(data: bytes) -> np.ndarray:
    return np.frombuffer(data[-2 * SIDE * SIDE :], dtype=">i2").reshape(SIDE, SIDE)


def coded(data: bytes, counts: np.ndarray) -> bytes:
    label = data[: -2 * SIDE * SIDE].replace(b'BIT_MODE_ID              = "NONE"',
                                             b'BIT_MODE_ID              = "LUT1"')  # fmt: skip
    label = label.replace(b"2#0000111111111111#", b"2#0000000011111111#")
    codes = np.abs(stored(data)[..., None] - counts).argmin(axis=-1)
    return label + codes.astype(">i2").tobytes()


def tables(folder: Path, counts: np.ndarray | None = COUNTS, extra: str = "") -> Path:
    """A folder of settings with a table, or with none."""
    folder.mkdir(exist_ok=True)
    table = (
        ""
        if counts is None
        else f'[companding.tables.LUT1]\ncounts = {counts.tolist()}\nsource = "a test"\n'
    )
    (folder / "spirit.toml").write_text(f'hosts = ["MER2"]\n{table}{extra}')
    return folder


def ingested(downlink: Path, store: Path, settings: Path) -> Workspace:
    workspace = Workspace.open(store)
    delivery = ingest_downlink.fn(downlink, workspace, load_radiometry(settings))
    assert not delivery.faults
    return workspace


def browse_of(workspace: Workspace, image_id: str) -> np.ndarray:
    path = workspace.store.path(workspace.catalogue.image(image_id).browse)
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def test_coded_pixels_are_decoded_wherever_they_are_read(frames, tmp_path):
    downlink = frames.coded(COUNTS).written(tmp_path / "downlink")
    workspace = ingested(downlink, tmp_path / "store", tables(tmp_path / "settings"))
    (pair,) = pairs_of(workspace.catalogue.images())
    for read, (name, data) in zip(
        read_pair(pair, workspace.store), sorted(frames.files.items()), strict=True
    ):
        counts = COUNTS[stored(coded(data, COUNTS))]
        np.testing.assert_array_equal(read.pixels[read.mask], counts[read.mask])
        assert read.notes == ()
        step = np.diff(COUNTS)[stored(coded(data, COUNTS)).clip(0, 254)]
        assert (np.abs(read.pixels - stored(data))[read.mask] <= step[read.mask]).all()
        np.testing.assert_array_equal(
            browse_of(workspace, name.partition(".")[0].upper()), stretch(read.pixels, read.mask)
        )
    assert workspace.catalogue.outcomes() == []


def test_codes_without_a_table_stay_codes_and_are_reported(frames, tmp_path):
    downlink = frames.coded(COUNTS).written(tmp_path / "downlink")
    workspace = ingested(downlink, tmp_path / "store", tables(tmp_path / "settings", None))
    (pair,) = pairs_of(workspace.catalogue.images())
    left, _ = read_pair(pair, workspace.store)
    np.testing.assert_array_equal(left.pixels, stored((downlink / min(frames.files)).read_bytes()))
    outcomes = workspace.catalogue.outcomes()
    assert {outcome.subject for outcome in outcomes} == set(frames.files)
    for outcome in outcomes:
        assert not outcome.is_failure
        assert outcome.notes == (
            "pixels are 8-bit codes of LUT1, not counts: no inverse table was given",
        )


SEGMENT = b"""GROUP = COMPRESSION_PARMS
  INST_CMPRS_SEGMENT_STATUS = (0,3)
  INST_CMPRS_SEG_FIRST_LINE = (1,129)
  INST_CMPRS_SEG_FIRST_LINE_SAMP = (1,1)
  INST_CMPRS_SEG_LINES = (128,128)
  INST_CMPRS_SEG_SAMPLES = (256,256)
END_GROUP = COMPRESSION_PARMS
"""


def test_lost_segments_are_masked_and_reported(frames, tmp_path):
    """The lower half did not come down; its label is a separate file."""
    name = min(frames.files)
    data = frames.files[name]
    label = data[: -2 * SIDE * SIDE].rstrip()
    label = re.sub(rb"\^IMAGE( +)= +\d+", rb'^IMAGE\1= ("DATA.IMG", 1)', label)
    label = label.replace(b"GROUP  ", SEGMENT + b"GROUP  ", 1)
    downlink = Frames({name: data[-2 * SIDE * SIDE :]}, {}).written(tmp_path / "downlink")
    (downlink / name).with_suffix(".lbl").write_bytes(label)
    workspace = ingested(downlink, tmp_path / "store", tables(tmp_path / "settings"))
    (entry,) = workspace.catalogue.images()
    read = read_product_image(image_file(entry), workspace.store)
    assert not read.mask[128:].any()
    assert read.mask[:128].mean() > 0.99
    note = f"{128 * SIDE} pixels are masked: their segments are marked as lost in the label"
    assert workspace.catalogue.outcomes()[0].notes == entry.notes == (note,)


def test_a_mission_without_tables_has_none_in_its_recipes(frames, tmp_path):
    """Products made before there were tables stay valid."""
    downlink = frames.written(tmp_path / "downlink")
    workspace = ingested(downlink, tmp_path / "store", tables(tmp_path / "settings"))
    (pair,) = pairs_of(workspace.catalogue.images())
    left, right = (
        workspace.catalogue.image(Path(name).stem.upper()) for name in sorted(frames.files)
    )
    assert left.radiometry is None  # a table is there, but these pixels are counts
    made = match_stereo_pair.fn(pair, MatchParams(), workspace.store)
    params = MatchParams().sparse
    recipe = Recipe(ProductKind.MATCHES, pair_scope(pair.id), (left.ref, right.ref), params)
    assert made.matches == recipe.ref


def test_vignetting_is_removed_from_matched_pixels(frames, tmp_path):
    downlink = frames.written(tmp_path / "downlink")
    models = "".join(f"[vignetting.NAVCAM_{eye}]\nk1 = {MODEL.k1}\n" for eye in ("LEFT", "RIGHT"))
    settings = tables(tmp_path / "settings", None, models)
    workspace = ingested(downlink, tmp_path / "store", settings)
    (pair,) = pairs_of(workspace.catalogue.images())
    assert len(set(pair.inputs)) == 4, "two images and what is known of each camera"
    left, _ = read_pair(pair, workspace.store)
    flat = MODEL.flat_field(1024, 1024).reshape(SIDE, 4, SIDE, 4).mean(axis=(1, 3))
    expected = stored(frames.files[min(frames.files)]) / flat
    np.testing.assert_allclose(left.pixels[left.mask], expected[left.mask], rtol=1e-5)


def test_a_changed_table_remakes_only_products_that_use_it(frames, tmp_path):
    left, right = sorted(frames.files)
    mixed = Frames({left: coded(frames.files[left], COUNTS), right: frames.files[right]}, {})
    downlink = mixed.written(tmp_path / "downlink")
    settings, store = tables(tmp_path / "settings"), tmp_path / "store"
    workspace = ingested(downlink, store, settings)
    made = files_of(workspace)
    assert files_of(ingested(downlink, store, settings)) == made, "unchanged: nothing is made"
    before = {entry.id: entry for entry in workspace.catalogue.images()}
    tables(settings, COUNTS // 2)
    ingested(downlink, store, settings)
    after = {entry.id: entry for entry in workspace.catalogue.images()}
    left, right = Path(left).stem.upper(), Path(right).stem.upper()
    assert after[right] == before[right]
    assert after[left].ref == before[left].ref
    assert after[left].browse != before[left].browse
    assert len(files_of(workspace) - made) == 4, "a table and a browse image, and their recipes"


def test_images_of_earlier_downlinks_are_read_with_a_new_table(frames, tmp_path):
    first = frames.coded(COUNTS).written(tmp_path / "first")
    (tmp_path / "second").mkdir()
    settings = tables(tmp_path / "settings", None)
    workspace = ingested(first, tmp_path / "store", settings)
    (pair,) = pairs_of(workspace.catalogue.images())
    tables(settings)
    ingested(tmp_path / "second", tmp_path / "store", settings)
    (again,) = pairs_of(workspace.catalogue.images())
    assert (again.left.image, again.right.image) == (pair.left.image, pair.right.image)
    assert again.left.radiometry is not None
    read = read_pair(again, workspace.store)[0]
    codes = stored((first / min(frames.files)).read_bytes())
    np.testing.assert_array_equal(read.pixels[read.mask], COUNTS[codes][read.mask])
    assert all(entry.notes == () for entry in workspace.catalogue.images())


def test_a_table_that_does_not_fit_is_a_fault_of_the_file(frames, tmp_path):
    """Labelled as codes, but with counts in it: the image is refused, the other is taken."""
    left, right = sorted(frames.files)
    files = frames.coded(COUNTS).files
    label = files[left][: -2 * SIDE * SIDE]
    broken = {left: label + stored(frames.files[left]).tobytes(), right: files[right]}
    downlink = Frames(broken, {}).written(tmp_path / "downlink")
    workspace = Workspace.open(tmp_path / "store")
    settings = load_radiometry(tables(tmp_path / "settings"))
    delivery = ingest_downlink.fn(downlink, workspace, settings)
    (fault,) = delivery.faults
    assert re.search(f"{left}: .*pixels up to .* are not 8-bit codes of LUT1", fault.notes[0])
    assert [entry.id for entry in workspace.catalogue.images()] == [Path(right).stem.upper()]


@pytest.mark.usefixtures("engine")
def test_a_run_maps_counts_and_reports_peculiarities(frames, tmp_path, monkeypatch):
    """Through the whole pipeline: first without a table, then with one, then with it again."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - needs the engine's settings

    downlink, store = frames.coded(COUNTS).written(tmp_path / "downlink"), tmp_path / "store"
    settings = tables(tmp_path / "settings", None)
    monkeypatch.setenv("SOLMAP_INSTRUMENTS", str(settings))
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml", FEW_LAYERS))
    report = process_downlink(downlink, store, pipeline)
    assert report.succeeded, report.failures
    note = "pixels are 8-bit codes of LUT1, not counts: no inverse table was given"
    names = [Path(name).stem.upper() for name in sorted(frames.files)]
    assert {f"{name}: {note}" for name in names} <= set(report.sols[0].notes)
    assert report.warnings == []
    assert f"{names[0]}: {note}" in "\n".join(report.lines)
    workspace = Workspace.open(store)
    outcomes = {outcome.subject: outcome for outcome in workspace.catalogue.outcomes()}
    assert outcomes[min(frames.files)].notes == (note,)
    of_sol = outcomes[f"mer2-sol{report.sols[0].sol:04d}"]
    assert any(note in line for line in of_sol.notes)
    coded_layers = layers_of(workspace)

    tables(settings)
    report = process_downlink(downlink, store, pipeline)
    assert report.succeeded, report.failures
    assert not any("codes" in line for line in report.sols[0].notes)
    layers = layers_of(workspace)
    assert layers["orthophoto"] != coded_layers["orthophoto"]
    assert layers["dtm"] != coded_layers["dtm"]
    made = files_of(workspace)
    assert process_downlink(downlink, store, pipeline).succeeded
    assert files_of(workspace) == made


def test_inspect_uses_the_tables_and_reports_peculiarities(frames, tmp_path, monkeypatch):
    downlink = frames.coded(COUNTS).written(tmp_path / "downlink")
    file, png = downlink / min(frames.files), tmp_path / "picture.png"
    monkeypatch.setenv("SOLMAP_INSTRUMENTS", str(tables(tmp_path / "settings", None)))
    shown = CliRunner().invoke(app, ["inspect", str(file)])
    assert shown.exit_code == 0, shown.output
    assert "note     pixels are 8-bit codes of LUT1" in shown.output
    tables(tmp_path / "settings")
    shown = CliRunner().invoke(app, ["inspect", str(file), "--json", "--png", str(png)])
    assert json.loads(shown.stdout)[0]["notes"] == []
    counts = COUNTS[stored(file.read_bytes())].astype(np.float32)
    mask = read_image(file.read_bytes(), file.name).mask
    np.testing.assert_array_equal(cv2.imread(str(png), cv2.IMREAD_UNCHANGED), stretch(counts, mask))


def layers_of(workspace: Workspace) -> dict[str, str]:
    return {str(layer.ref.kind): layer.ref.digest for layer in workspace.catalogue.layers()}


def files_of(workspace: Workspace) -> set[str]:
    return {str(path) for path in (workspace.store.root / "products").rglob("*.*")}
