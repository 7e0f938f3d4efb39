"""Edits of ties made on the map become a file of manual ties, which the next run carries out."""

import pytest

from solmap.photogrammetry.matching.manual.editing import EditAction
from solmap.products.catalogue.edits import EditKind, EditLog
from solmap.products.catalogue.workspace import Workspace
from solmap.tasks.images.manual_ties import all_edit_requests, take_edits

VETO = {"action": "veto", "first_image": "A", "second_image": "B"}
ADD = {
    "action": "add",
    "first_image": "A",
    "first_sample": 1.5,
    "first_line": 2.5,
    "second_image": "C",
    "second_sample": 3.5,
    "second_line": 4.5,
    "sigma_px": 0.5,
}


@pytest.fixture
def workspace(tmp_path):
    return Workspace.open(tmp_path)


def test_a_store_without_edits_gets_no_file(workspace):
    take_edits(workspace)
    assert all_edit_requests(workspace) == ()
    assert workspace.catalogue.version() == 0


def test_edits_are_requests_until_they_are_revoked(workspace):
    log = EditLog.of(workspace.store.root)
    log.append("MER2", EditKind.TIE, VETO, "Ada", "another rock")
    added = log.append("MER2", EditKind.TIE, ADD, "Ada")
    log.append("MER2", EditKind.ANNOTATION, {"text": "no tie"}, "Ada")
    take_edits(workspace)
    veto, add = all_edit_requests(workspace)
    assert (veto.action, add.action) == (EditAction.VETO, EditAction.ADD)
    assert (add.first.point, add.second.point, add.sigma_px) == ((1.5, 2.5), (3.5, 4.5), 0.5)
    log.undo("MER2", added.id, "Ben")
    take_edits(workspace)
    assert all_edit_requests(workspace) == (veto,)
    log.undo("MER2", 1, "Ben")
    take_edits(workspace)
    assert all_edit_requests(workspace) == ()


def test_manual_tie_files_are_kept_beside_the_edits(workspace):
    from solmap.tasks.images.manual_ties import take_manual_ties  # noqa: PLC0415

    ref = take_manual_ties(
        "mine.ties.csv", b"action,first_image,second_image\nveto,X,Y\n", workspace.store
    )
    workspace.catalogue.publish(pointers=[ref])
    EditLog.of(workspace.store.root).append("MER2", EditKind.TIE, VETO, "Ada")
    take_edits(workspace)
    assert {edit.first.image for edit in all_edit_requests(workspace)} == {"A", "X"}
