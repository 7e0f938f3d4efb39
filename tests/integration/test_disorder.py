"""What is published is a function of the files that came, not of how they came."""

from pathlib import Path

import numpy as np
import pytest

from solmap.products.catalogue.maintenance.pruning import _known_products
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef
from solmap.tasks.network.orientations import read_orientations
from tests.support.disorder import deliveries, differences
from tests.support.small_downlink import (
    COARSE,
    FEW_LAYERS,
    write_coarse_pipeline,
    write_small_downlink,
)
from tests.support.store_checks import Contents, faults

pytestmark = [pytest.mark.usefixtures("engine"), pytest.mark.slow]


def compared(tmp_path: Path, sols: int, turns: int, seed: int, layers: str = COARSE) -> list[str]:
    """How a run in disorder differs from one of the whole downlink at once."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings

    downlink = write_small_downlink(tmp_path / "downlink", stops=sols, pairs=1)
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml", layers))
    clean, disordered = tmp_path / "clean", tmp_path / "disordered"
    process_downlink(downlink, clean, pipeline)
    rng = np.random.default_rng(seed)
    for delivery in deliveries(downlink, tmp_path / "deliveries", turns, rng):
        process_downlink(delivery, disordered, pipeline)
    assert faults(disordered) == []
    return differences(Contents.of(clean), Contents.of(disordered))


@pytest.mark.parametrize("seed", [1])
def test_four_sols_in_disorder_end_as_in_order(tmp_path: Path, seed: int) -> None:
    assert compared(tmp_path, sols=4, turns=3, seed=seed) == []


def test_a_late_image_remakes_only_what_depends_on_it(tmp_path: Path) -> None:
    """The right image of a pair of the second of three sols comes last."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings

    downlink = write_small_downlink(tmp_path / "downlink", stops=3, pairs=2)
    pipeline = str(write_coarse_pipeline(tmp_path / "coarse.toml"))
    root = tmp_path / "store"
    right = max((downlink / "sol0156").rglob("2n*r0m1.img"))
    late = tmp_path / "late" / right.name
    late.parent.mkdir()
    right.rename(late)
    process_downlink(downlink, root, pipeline)
    workspace = Workspace.open(root)
    before = set(workspace.store.refs())
    report = process_downlink(late.parent, root, pipeline)

    entry = workspace.catalogue.image(late.stem.upper())
    fresh = set(workspace.store.refs()) - before
    assert {one.scope.name for one in fresh if one.kind is ProductKind.MATCHES} == {
        entry.partner.lower()
    }
    assert {sol.sol for sol in report.sols if sol.notes} == {155, 156, 157}
    networks = {one.scope.name for one in fresh if one.kind is ProductKind.NETWORK}
    assert networks == {"mer2-sol0156", "mer2-sol0157"}
    remapped = {
        stop
        for ref in fresh
        if ref.kind is ProductKind.ORIENTATIONS
        for stop, mapped in read_orientations(ref, workspace.store, ()).items()
        if mapped.is_new
    }
    independent = fresh - dependents(entry.ref, workspace)
    assert {one.scope.name for one in independent} <= remapped  # by poses, plain numbers
    assert remapped == {entry.stop, "mer2-site0011-drive0000"}
    assert not {one for one in fresh if one.scope.name == "mer2-site0010-drive0000"}


def dependents(ref: ProductRef, workspace: Workspace) -> set[ProductRef]:
    """What is made from a product, from what that made, and so on; and the product."""
    known = dict(_known_products(workspace))
    name, found = f"{ref.kind}/{ref.scope}/{ref.digest}", set()
    waiting = [name]
    while waiting:
        one = waiting.pop()
        if one not in found:
            found.add(one)
            waiting += [other for other, what in known.items() if one in what.inputs]
    return {known[one].ref for one in found}


def test_thirty_sols_in_disorder_end_as_in_order(tmp_path: Path) -> None:
    assert compared(tmp_path, sols=30, turns=3, seed=30, layers=FEW_LAYERS) == []
