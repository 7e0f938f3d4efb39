from dataclasses import replace
from datetime import UTC, datetime

import pytest

from solmap.products.catalogue.catalogue import Catalogue, ImageEntry, MissionEntry, Outcome
from solmap.products.crs import LandingPoint
from solmap.products.errors import ProductNotFoundError
from solmap.products.model import Layer, ProductKind, ProductRef, Scope, ScopeLevel

STOP = Scope(ScopeLevel.STOP, "mer2-site0010-drive0064")
LANDING = LandingPoint("Columbia", 175.4729, -14.5692, 3_393_000.0, "Arvidson et al. 2004")
MISSION = MissionEntry("MER2", "Spirit", LANDING, None)


def a_layer(digest: str = "a" * 16) -> Layer:
    return Layer(
        ref=ProductRef(ProductKind.DTM, STOP, digest),
        mission="MER2",
        title="Elevation",
        type="raster",
        bounds=(0.0, 0.0, 10.24, 10.24),
        cell_m=0.04,
        unit="m",
        range=(-1.5, 2.5),
        sols=(156,),
        made_at="2026-11-21T02:00:00+00:00",
    )


def an_image(name: str = "2N1", sol: int = 156) -> ImageEntry:
    scope = Scope(ScopeLevel.IMAGE, name.lower())
    return ImageEntry(
        id=name,
        mission="MER2",
        stop=STOP.name,
        site=10,
        drive=64,
        sol=sol,
        instrument="NAVCAM",
        eye="left",
        product_type="EFF",
        start_time=None,
        local_solar_time=None,
        partner=None,
        unpaired_because="no right-eye partner",
        ref=ProductRef(ProductKind.IMAGE, scope, "b" * 16),
        browse=ProductRef(ProductKind.BROWSE, scope, "c" * 16),
    )


@pytest.fixture
def catalogue(tmp_path, catalogue_url):
    opened = Catalogue.open(tmp_path, catalogue_url)
    yield opened
    opened.engine.dispose()


def test_a_published_layer_is_read_back_unchanged(catalogue):
    outcome = Outcome("mer2-sol0156", is_failure=False, notes=("12 ties",), at="now")
    catalogue.publish(
        missions=[MISSION], images=[an_image()], layers=[a_layer()], outcomes=[outcome]
    )
    assert catalogue.missions() == [MISSION]
    assert catalogue.images() == [an_image()]
    assert catalogue.layers("MER2") == [a_layer()]
    assert catalogue.outcomes() == [outcome]


def test_an_entry_has_the_stop_of_its_name():
    assert str(an_image().stop_id) == an_image().stop


def test_a_new_outcome_has_the_current_time():
    before = datetime.now(UTC).replace(microsecond=0)
    outcome = Outcome.now("mer2-sol0156", ("12 ties",))
    assert before <= datetime.fromisoformat(outcome.at) <= datetime.now(UTC)
    assert not outcome.is_failure


def test_the_latest_version_of_a_layer_is_listed_and_older_ones_stay_readable(catalogue):
    older, newer = a_layer("a" * 16), a_layer("d" * 16)
    catalogue.publish(layers=[older])
    catalogue.publish(layers=[newer])
    assert catalogue.layers() == [newer]
    assert catalogue.layer(STOP.name, ProductKind.DTM) == newer
    assert catalogue.layer(STOP.name, ProductKind.DTM, older.ref.digest) == older


def test_an_event_lists_exactly_the_layers_that_changed(catalogue):
    catalogue.publish(layers=[a_layer()])
    catalogue.publish(layers=[a_layer()])
    events = catalogue.events_since(0)
    assert [event.document for event in events] == [
        {"mission": "MER2", "layers": [f"{STOP.name}/dtm"]}
    ]
    assert catalogue.events_since(events[-1].id) == []


def test_a_withdrawn_layer_leaves_the_map_with_an_event(catalogue):
    catalogue.publish(layers=[a_layer("a" * 16)])
    catalogue.withdraw([a_layer("b" * 16)])  # another version than the latest
    assert [layer.ref.digest for layer in catalogue.layers()] == ["a" * 16]
    before = catalogue.version()
    catalogue.withdraw([a_layer("a" * 16)])
    assert catalogue.layers() == []
    assert catalogue.layer(STOP.name, ProductKind.DTM, "a" * 16) == a_layer("a" * 16)
    reported = [event.document["layers"] for event in catalogue.events_since(before)]
    assert reported == [[f"{STOP.name}/dtm"]]


def test_a_failing_publication_publishes_nothing(catalogue):
    broken = replace(a_layer("e" * 16), unit=object())
    with pytest.raises(Exception, match="not JSON serializable"):
        catalogue.publish(missions=[MISSION], layers=[a_layer(), broken])
    assert catalogue.missions() == []
    assert catalogue.layers() == []


def test_images_are_found_by_stop_and_sol(catalogue):
    catalogue.publish(images=[an_image("2N1", 155), an_image("2N2", 156)])
    assert [entry.id for entry in catalogue.images(sol=156)] == ["2N2"]
    assert [entry.id for entry in catalogue.images(stop=STOP.name)] == ["2N1", "2N2"]
    assert catalogue.image("2N1").sol == 155


@pytest.mark.parametrize(
    ("query", "message"),
    [
        (lambda c: c.image("2N9"), "no image '2N9' has been ingested"),
        (lambda c: c.layer("x", ProductKind.DTM), "no dtm of x has been published"),
        (lambda c: c.mission("MER9"), "no mission 'MER9' is in the store"),
    ],
)
def test_unknown_entries_are_named(catalogue, query, message):
    with pytest.raises(ProductNotFoundError, match=message):
        query(catalogue)
