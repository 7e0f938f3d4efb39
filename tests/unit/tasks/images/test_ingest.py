"""Every file of a downlink is taken or has one line of its own, whatever is in it."""

import json
import os
import shutil
from pathlib import Path

import pytest

from solmap.products.catalogue import catalogue as catalogues
from solmap.products.catalogue.maintenance.pruning import PruningParams, prune
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import StoreAwayError
from solmap.tasks.images import ingest
from solmap.tasks.images.ingest import ingest_downlink
from tests.support.hostile_files import (
    HEAD,
    VALID_METADATA,
    label_with,
    write_hostile_files,
)
from tests.support.small_downlink import write_small_downlink


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> Path:
    return write_small_downlink(tmp_path_factory.mktemp("pair"), stops=1, pairs=1)


@pytest.fixture
def downlink(pair, tmp_path) -> Path:
    return Path(shutil.copytree(pair, tmp_path / "downlink"))


@pytest.fixture
def store(tmp_path) -> Workspace:
    return Workspace.open(tmp_path / "store")


def take(downlink, store):
    """Lines of what was refused; both good images must be there."""
    delivery = ingest_downlink.fn(downlink, store)
    assert len(delivery.images) == 2
    assert len(store.catalogue.images()) == 2
    assert len(store.catalogue.outcomes()) == len(delivery.faults)
    return [note for fault in delivery.faults for note in fault.notes]


def png(downlink, **changed):
    import cv2  # noqa: PLC0415 - slow to import
    import numpy as np  # noqa: PLC0415

    cv2.imwrite(str(downlink / "bad.png"), np.full((2, 3), 7, np.uint8))
    (downlink / "bad.json").write_text(json.dumps({**VALID_METADATA, **changed}))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"sclk": int("9" * 400)}, "sclk should be seconds"),
        ({"imageid": "A\0B"}, "the product identifier"),
        ({"imageid": "\ud800"}, "the product identifier"),
        ({"imageid": "/."}, "the product identifier"),
    ],
)
def test_metadata_with_unrepresentable_values(downlink, store, changed, message):
    png(downlink, **changed)
    (line,) = take(downlink, store)
    assert line.startswith("bad.png: ")
    assert message in line
    prune(store, PruningParams())  # which an identifier "/." made fail for good


def test_a_manual_tie_with_a_sigma_of_401_digits(downlink, store):
    row = {"properties": {"action": "add", "sigma_px": int("9" * 401)}}
    (downlink / "a.ties.geojson").write_text(json.dumps({"features": [row]}))
    (downlink / "b.ties.csv").write_text(f"{HEAD}\nadd,A,1,1,B,1,1,{'9' * 401}")
    lines = take(downlink, store)
    assert [line[:20] for line in lines] == ["a.ties.geojson, row ", "b.ties.csv, row 1: s"]


def test_a_sol_of_38_digits(downlink, store):
    image = min(downlink.rglob("*l0m1.img")).read_bytes()
    damaged = label_with(image, ("PLANET_DAY_NUMBER", "9" * 38))
    (downlink / "2n140188888eff1000p1500l0m1.img").write_bytes(damaged)
    (line,) = take(downlink, store)
    assert "the sol should be from 0 to 100,000" in line


def test_names_that_are_not_text(downlink, store):
    for name in (b"\xff\xfe.img", b"two\nlines.img", b"n" * 251 + b".img", b"\xe2\x80\xaex.svf"):
        Path(os.fsdecode(os.fsencode(downlink) + b"/" + name)).write_bytes(b"nothing")
    lines = take(downlink, store)
    assert len(lines) == 4
    assert all(line.isprintable() for line in lines)
    assert lines[-1].startswith("\\xff\\xfe.img: not a PDS3 image")


def test_a_good_image_under_a_name_that_is_not_text_is_ingested(downlink, store):
    left = min(downlink.rglob("*l0m1.img"))
    left.rename(os.fsdecode(os.fsencode(left.parent) + b"/\xff.img"))
    assert take(downlink, store) == []


@pytest.mark.parametrize("fault", [RecursionError, MemoryError, OverflowError, UnicodeError])
def test_any_exception_of_a_reader_is_the_outcome_of_its_file(downlink, store, monkeypatch, fault):
    shutil.copy(min(downlink.rglob("*l0m1.img")), downlink / "broken.img")
    describe = ingest.describe_image

    def fail(data, name):
        if name == "broken.img":
            raise fault("with\ntwo lines")
        return describe(data, name)

    monkeypatch.setattr(ingest, "describe_image", fail)
    (line,) = take(downlink, store)
    assert line == f"broken.img: {fault.__name__}: with two lines"


def test_an_unreadable_folder_is_reported_with_the_reason(downlink, store, monkeypatch):
    (downlink / "closed").mkdir()
    look = os.scandir

    def refuse(path):
        if str(path).endswith("/closed"):  # as for any user but root
            raise PermissionError(13, "Permission denied", str(path))
        return look(path)

    monkeypatch.setattr(os, "scandir", refuse)
    assert take(downlink, store) == ["closed: Permission denied"]


def test_an_unreachable_store_is_not_a_fault_of_a_file(downlink, store, monkeypatch):
    def fail(*_arguments):
        raise StoreAwayError("the store does not answer")

    monkeypatch.setattr(ingest, "_take_file", fail)
    monkeypatch.setattr(ingest, "retry_transient", lambda call: call())
    with pytest.raises(StoreAwayError):
        ingest_downlink.fn(downlink, store)


def test_an_image_refused_by_the_catalogue_is_left_out(downlink, store, monkeypatch):
    left = min(downlink.rglob("*l0m1.img"))
    shutil.copy(left, downlink / "2n140188888eff1000p1500l0m1.img")
    put = catalogues.put_document

    def fail(connection, table, keys, document, **columns):
        if keys.get("id") == "2N140188888EFF1000P1500L0M1":
            raise ValueError("a number too large to store")
        return put(connection, table, keys, document, **columns)

    monkeypatch.setattr(catalogues, "put_document", fail)
    (line,) = take(downlink, store)
    assert line == "2n140188888eff1000p1500l0m1.img: ValueError: a number too large to store"


def test_files_of_one_name_are_distinguished_by_their_folders(downlink, store):
    good = min(downlink.rglob("*.img"))
    for folder in ("a", "b"):
        (downlink / folder).mkdir()
        (downlink / folder / good.name).write_bytes(b"no image at all")
    delivery = ingest_downlink.fn(downlink, store)
    names = {f"{folder}/{good.name}" for folder in ("a", "b")}
    assert {fault.subject for fault in delivery.faults} == names
    assert {one.subject for one in store.catalogue.outcomes() if one.is_failure} == names


def test_a_failed_file_is_retried(downlink, store):
    good = min(downlink.rglob("*r0m1.img"))
    data = good.read_bytes()
    good.write_bytes(data[:5000])
    delivery = ingest_downlink.fn(downlink, store)
    assert [fault.subject for fault in delivery.faults] == [good.name]
    good.write_bytes(data)
    assert ingest_downlink.fn(downlink, store).faults == ()
    assert [one.is_failure for one in store.catalogue.outcomes()] == [False]
    assert {image.partner is None for image in store.catalogue.images()} == {False}


@pytest.mark.slow
def test_four_hundred_hostile_files_each_give_one_line(downlink, store):
    names = write_hostile_files(downlink)
    delivery = ingest_downlink.fn(downlink, store)
    assert len(names) > 300
    assert sorted(fault.subject for fault in delivery.faults) == sorted(names)
    for fault in delivery.faults:
        (line,) = fault.notes
        assert line.isprintable()
        assert " ".join(fault.subject.split()) in line
    assert len(delivery.images) == len(store.catalogue.images()) == 2
