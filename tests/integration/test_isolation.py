"""One error, in any stage, or one label that cannot be true: only what depends on it is missing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind
from tests.support.disorder import differences
from tests.support.injection import (
    BY_COMMAND,
    ERRORS,
    NOT_REACHED,
    CleanRun,
    chosen,
    process,
    stages,
    violations,
)
from tests.support.small_downlink import FEW_LAYERS, write_coarse_pipeline, write_small_downlink
from tests.support.store_checks import Contents

pytestmark = pytest.mark.usefixtures("engine")
OFFSET = re.compile(rb"(ROVER_COORDINATE_SYSTEM.*?ORIGIN_OFFSET_VECTOR\s*= )(\([^)]*\))", re.DOTALL)


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory, engine: None) -> CleanRun:  # noqa: ARG001
    """Two stops of one pair each, with a few layers."""
    return CleanRun.of(tmp_path_factory.mktemp("few"), pairs=1, layers=FEW_LAYERS)


@pytest.mark.parametrize(
    ("stage", "error"),
    [
        ("trace_contours", "surrogate"),
        pytest.param("publish", "long", marks=pytest.mark.slow),
    ],
)
def test_an_error_in_a_stage_loses_only_what_depends_on_it(clean, stage, error):
    rng = np.random.default_rng(sum(map(ord, stage)))
    assert violations(clean, chosen(clean, stage, rng, error)) == []


@pytest.mark.slow
def test_no_error_in_any_stage_loses_more_than_what_depends_on_it(tmp_path):
    """Three errors a stage; all of them: `python -m tests.support.injection --errors 32`."""
    whole = CleanRun.of(tmp_path)
    called = {call.stage for call in whole.calls}
    assert called == stages().keys() - BY_COMMAND - NOT_REACHED  # a new stage is met too
    rng = np.random.default_rng(17)
    for stage in sorted(called):
        for error in rng.permutation(sorted(ERRORS))[:3]:
            found = violations(whole, chosen(whole, stage, rng, str(error)))
            assert (stage, error, found) == (stage, error, [])


def misplace(label: Path, north_m: float, year: bytes = b"2004") -> bytes:
    """An image whose label places the rover so far north in its site; the bytes it had."""
    data = label.read_bytes()
    found = OFFSET.search(data)
    assert found is not None
    vector = f"({north_m:g},0,0)".encode().ljust(len(found[2]))
    assert len(vector) == len(found[2])
    changed = data[: found.start(2)] + vector + data[found.end(2) :]
    changed = changed.replace(
        b"CREATION_TIME            = 2004", b"CREATION_TIME            = " + year
    )
    label.write_bytes(changed)
    return data


@pytest.mark.slow
@pytest.mark.parametrize(("metres", "sol"), [(5000.0, 155), (-5000.0, 156), (90_000.0, 157)])
def test_a_misplaced_stop_has_its_own_map_and_returns_after_a_correction(tmp_path, metres, sol):
    downlink = write_small_downlink(tmp_path / "downlink", stops=3, pairs=1)
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml", FEW_LAYERS))
    assert process(downlink, tmp_path / "true", pipeline).succeeded
    images = sorted((downlink / f"sol0{sol}").rglob("2n*m1.img"))
    true = {image: misplace(image, metres) for image in images}
    root = tmp_path / "store"
    report = process(downlink, root, pipeline)

    assert report.succeeded, report.failures
    (line,) = [note for one in report.sols for note in one.notes if "map of its own" in note]
    assert "m from mer2-site" in line
    catalogue = Workspace.open(root).catalogue
    (alone,) = [name for name in catalogue.maps_of("MER2") if name != "MER2"]
    (outcome,) = [
        one for one in catalogue.outcomes() if one.subject == f"{alone.lower()}-sol0{sol}"
    ]
    assert line in outcome.notes
    kinds = published_kinds(root)
    expected = published_kinds(tmp_path / "true")
    assert len(kinds) == 3
    assert all(kinds[stop] >= expected[stop] - {"far-dtm", "far-contours"} for stop in kinds)
    assert {"traverse", "stops"} <= {
        str(layer.ref.kind) for layer in Workspace.open(root).catalogue.layers()
    }

    for image, data in true.items():
        image.write_bytes(data.replace(b"TIME            = 2004-06", b"TIME            = 2005-06"))
    assert process(downlink, root, pipeline).succeeded
    assert published_kinds(root) == expected
    assert not [
        line
        for line in differences(Contents.of(tmp_path / "true"), Contents.of(root))
        if line.startswith("outcomes")
    ]


def published_kinds(root: Path) -> dict[str, set[str]]:
    """The layers of every stop."""
    found: dict[str, set[str]] = {}
    for layer in Workspace.open(root).catalogue.layers():
        if layer.ref.kind not in {ProductKind.TRAVERSE, ProductKind.STOPS}:
            found.setdefault(layer.ref.scope.name, set()).add(str(layer.ref.kind))
    return {stop: kinds for stop, kinds in found.items() if "-site" in stop and "dtm" in kinds}
