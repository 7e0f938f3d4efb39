"""A product that cannot be read is left out of what is published, and named."""

from solmap.products.catalogue.workspace import Workspace
from solmap.tasks.mission import publish as module
from solmap.tasks.mission.publish import publish
from tests.support.bowl_store import fill


def test_one_broken_layer_and_a_broken_stac_leave_the_others_published(tmp_path, monkeypatch):
    workspace = Workspace.open(tmp_path / "store")
    fill(workspace)
    rasters = [one for one in workspace.catalogue.layers() if one.ref.kind in module.RASTERS]
    broken = rasters[0]
    workspace.store.path(broken.ref).write_bytes(b"no raster")
    described = []
    monkeypatch.setattr(module, "update_stac", lambda *given: described.append(given) or 1 / 0)

    entry = workspace.catalogue.mission(broken.mission)
    published = publish.fn(entry, [(one.ref, one.sols) for one in rasters], (), (), workspace)
    assert {one.ref for one in published.layers} == {one.ref for one in rasters[1:]}
    assert len(published.layers) == len(rasters) - 1 > 0
    assert set(published.failures) == {f"{broken.ref.kind} of {broken.ref.scope}", "STAC catalogue"}
    assert all(cause.isprintable() for cause in published.failures.values())
    assert described
