"""Manual ties on their way from a file to the network."""

import numpy as np
import pytest
from typer.testing import CliRunner

from solmap.flows.cli import app
from solmap.photogrammetry.adjustment.model.adjusted_network import USED
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode
from solmap.photogrammetry.imagery import TieKind
from solmap.photogrammetry.matching.inter_stereo import InterStereoParams
from solmap.photogrammetry.synthetic.scene import WorldParams
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.products.catalogue.images import image_records
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.archives import read_matches, read_ties, write_ties
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductKind, Recipe, Scope, ScopeLevel
from solmap.tasks.images.ingest import ingest_downlink
from solmap.tasks.images.manual_ties import all_edit_requests, requests_within
from solmap.tasks.images.pairs import pairs_of, read_pair
from solmap.tasks.images.telemetry import read_telemetry
from solmap.tasks.network.adjust import NetworkParams, NetworkStep, adjust_network
from solmap.tasks.network.match import MatchParams, match_stereo_pair
from solmap.tasks.network.tie import StopProducts, tie_stop
from tests.support.small_downlink import rendered_images

HEAD = (
    "action,first_image,first_sample,first_line,second_image,second_sample,second_line,sigma_px\n"
)


class Stop:
    """A stop with two neighbouring pairs, matched and tied."""

    def __init__(self, folder):
        world = WorldParams("plains", TraverseParams(stops=1), pairs=2, averaging=2)
        self.downlink = folder / "downlink"
        for file in rendered_images(world, 5):
            path = self.downlink / file.path.rpartition("/")[2]
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(file.data)
        self.workspace = Workspace.open(folder / "store")
        self.store = self.workspace.store
        ingest_downlink.fn(self.downlink, self.workspace)
        entries = self.workspace.catalogue.images()
        self.telemetry = read_telemetry(image_records(entries, self.workspace), ())
        self.pairs = tuple(
            match_stereo_pair.fn(pair, MatchParams(), self.store) for pair in pairs_of(entries)
        )
        (placed,) = self.telemetry.stops
        self.stop = placed.stop
        products = StopProducts(self.stop, self.pairs)
        self.ties = tie_stop.fn(products, placed, InterStereoParams(), self.store)

    @property
    def ids(self):
        return [pair.files.id for pair in self.pairs]

    def network(self, edits=(), links=()):
        step = NetworkStep(
            mission=self.stop.mission,
            sol=self.telemetry.stops[0].sols[0],
            mode=AdjustmentMode.STEPWISE,
            previous=None,
            stops=self.telemetry.stops,
            new_stops=(self.stop,),
            window=(self.stop,),
            pairs=self.pairs,
            ties=(self.ties,),
            links=links,
            edit_requests=requests_within(edits, set(self.ids)),
        )
        return adjust_network.fn(step, NetworkParams(), self.store)

    def edits(self, text):
        (self.downlink / "mine.ties.csv").write_text(HEAD + text)
        assert not ingest_downlink.fn(self.downlink, self.workspace).faults
        return all_edit_requests(self.workspace)

    def clicks(self, count):
        """Where the originals of both left images show some automatic ties."""
        ties, _ = read_ties(self.store.path(self.ties))
        rows = np.linspace(0, len(ties) - 1, count).astype(int)
        shown = []
        for index, left in ((ties.first, ties.first_left), (ties.second, ties.second_left)):
            name = ties.pair_ids[index[0]]
            pair = next(p for p in self.pairs if p.files.id == name)
            geometry, _ = read_matches(self.store.path(pair.matches))
            camera = read_pair(pair.files, self.store)[0].image.camera
            ground = camera.centre + 5.0 * geometry.directions(left[rows])
            shown.append((name, camera.project(ground)))
        (one, first), (other, second) = shown
        return [
            f"{one},{a[0]:.2f},{a[1]:.2f},{other},{b[0]:.2f},{b[1]:.2f}"
            for a, b in zip(first, second, strict=True)
        ]


@pytest.fixture(scope="module")
def stop(tmp_path_factory):
    return Stop(tmp_path_factory.mktemp("hand"))


def joining(stop, ref):
    """How many tie points join both pairs."""
    ties = read_network(ref, stop.store).adjusted.ties
    used = ties.status == USED
    seen = set(zip(ties.observations.point[used], ties.observations.pair[used], strict=True))
    points = [p for p, _ in seen]
    return sum(points.count(p) > 1 for p in set(points))


def test_a_vetoed_link_is_removed_from_the_network(stop):
    automatic = stop.network()
    assert joining(stop, automatic) > 20
    vetoed = stop.network(stop.edits(f"veto,{stop.ids[0]},,,{stop.ids[1]},,\n"))
    assert joining(stop, vetoed) == 0
    lines = read_network(vetoed, stop.store).manual_tie_notes
    assert "0 added, 0 moved" in lines[0]
    assert all(pair.ties == 0 for pair in read_network(vetoed, stop.store).adjusted.pairs)


def test_a_link_without_remaining_ties_is_not_a_link(stop):
    """The stop's own ties represent those of a link between two stops."""
    ties, _ = read_ties(stop.store.path(stop.ties))
    scope = Scope(ScopeLevel.STOP, "one-to-other")
    figures = {"earlier": "one", "later": "other", "linked": True, "reason": "so many ties"}
    link = stop.store.make(
        Recipe(ProductKind.LINKS, scope), lambda path: write_ties(path, ties, figures)
    )
    before = read_network(stop.network(links=(link,)), stop.store)
    assert before.links[0]["linked"]
    edits = stop.edits(f"veto,{stop.ids[0]},,,{stop.ids[1]},,\n")
    after = read_network(stop.network(edits, links=(link,)), stop.store)
    assert not after.links[0]["linked"]
    assert after.links[0]["reason"] == "all its ties are vetoed manually"


def test_a_network_of_manual_ties_alone_is_adjusted(stop):
    added = "".join(f"add,{click},0.2\n" for click in stop.clicks(9))
    ref = stop.network(stop.edits(f"veto,{stop.ids[0]},,,{stop.ids[1]},,\n{added}"))
    product = read_network(ref, stop.store)
    assert "9 added" in product.manual_tie_notes[0]
    assert joining(stop, ref) == 9
    assert product.report["ties"][str(TieKind.INTER_STEREO)] == 9
    alone, all_ties = (turn_between(stop, network) for network in (ref, stop.network()))
    # nine clicks to 0.2 px (0.02 degrees) over a narrow overlap, which determines the roll least
    assert np.degrees(np.abs(alone - all_ties)).max() < 0.06


def turn_between(stop, ref):
    """By how much the second pair is turned from its label, beyond the first."""
    pointing = {p.pair_id: p.pointing for p in read_network(ref, stop.store).adjusted.pairs}
    return pointing[stop.ids[1]] - pointing[stop.ids[0]]


def test_a_veto_at_a_point_removes_that_tie(stop):
    (click,) = stop.clicks(1)
    one, sample, line, other, _, _ = click.split(",")
    edits = stop.edits(f"veto,{one},{sample},{line},{other},,\n")
    product = read_network(stop.network(edits), stop.store)
    assert product.manual_tie_notes == ("manual ties: 0 added, 0 moved, 1 vetoed",)


def test_edits_of_other_images_remake_nothing(stop):
    before = stop.network()
    assert stop.network(stop.edits("veto,2N999,,,2N998,,\n")) == before
    assert stop.network(stop.edits("")) == before


def test_the_row_of_an_edit_in_its_file_changes_nothing(stop):
    veto = f"veto,{stop.ids[0]},,,{stop.ids[1]},,\n"
    assert stop.network(stop.edits(veto)) == stop.network(stop.edits(f"\n\n{veto}"))


def test_a_broken_file_is_one_line_and_the_rest_continues(stop, tmp_path):
    downlink = tmp_path / "downlink"
    downlink.mkdir()
    image = next(stop.downlink.glob("*.img"))
    (downlink / image.name).write_bytes(image.read_bytes())
    (downlink / "broken.ties.geojson").write_text('{"features": [{"properties": {"action": 3}}]}')
    workspace = Workspace.open(tmp_path / "store")
    delivery = ingest_downlink.fn(downlink, workspace)
    assert len(delivery.images) == 1
    (fault,) = delivery.faults
    assert fault.notes == (
        "broken.ties.geojson, row 1: action should be add, veto or move, not '3'",
    )
    assert workspace.catalogue.pointers(ProductKind.MANUAL_TIES) == []


def test_the_command_takes_a_file_and_reports_its_rows(stop, tmp_path):
    file = tmp_path / "from the editor.geojson"
    file.write_text(
        '{"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": null, '
        f'"properties": {{"action": "veto", "first_image": "{stop.ids[0]}", '
        '"second_image": "2N1"}}]}'
    )
    done = CliRunner().invoke(app, ["ties", str(file), "--store", str(stop.store.root)])
    assert done.exit_code == 0
    assert "0 to add, 1 to veto, 0 to move" in done.output
    assert "2N1 is not in the store (yet)" in done.output
    (tmp_path / "b.csv").write_text("no ties")
    done = CliRunner().invoke(
        app, ["ties", str(tmp_path / "b.csv"), "--store", str(stop.store.root)]
    )
    assert done.exit_code == 1
    assert "b.csv: the first line should name the columns" in done.output.replace("\n", " ")
