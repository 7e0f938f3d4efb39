"""Stages: looked up where their products exist, else submitted to the engine."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from prefect import Task

from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import NotMadeError, ProductStore, looking_up
from solmap.tasks.stage import stage

STOP = Scope(ScopeLevel.STOP, "mer2-site0001-drive0002")
SLOPE, ASPECT = (Recipe(kind, STOP) for kind in (ProductKind.SLOPE, ProductKind.ASPECT))


@stage(task_run_name="relief")
def map_relief(store: ProductStore) -> list[ProductRef]:
    return [store.make(recipe, text("made")) for recipe in (SLOPE, ASPECT)]


def text(content: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(content)


@pytest.fixture
def store(tmp_path: Path) -> ProductStore:
    return ProductStore.open(tmp_path)


@pytest.fixture
def submitted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the tasks that were submitted to the engine."""
    names: list[str] = []
    monkeypatch.setattr(Task, "submit", lambda task, *_, **__: names.append(task.name))
    return names


def test_a_stage_whose_products_exist_is_looked_up(store, submitted):
    for recipe in (SLOPE, ASPECT):
        store.make(recipe, text("made before"))
    future, heard = map_relief.submit(store), list[Any]()
    future.add_done_callback(heard.append)
    assert future.result() == [SLOPE.ref, ASPECT.ref]
    assert heard == [future]
    assert submitted == []


def test_a_stage_that_lacks_a_product_is_submitted_and_makes_nothing_before(store, submitted):
    store.make(SLOPE, text("made before"))
    map_relief.submit(store)
    assert submitted == ["map_relief"]
    assert not store.has(ASPECT.ref)


def test_an_error_of_the_look_up_is_left_to_the_task(store, submitted, monkeypatch):
    def fail(*_: object) -> bool:
        raise OSError("the disk is away")

    monkeypatch.setattr(ProductStore, "has", fail)
    map_relief.submit(store)
    assert submitted == ["map_relief"]


def test_a_stage_that_does_more_than_make_products_is_always_submitted(submitted):
    published: list[str] = []
    publish = stage("publish", makes_products=False)(lambda: published.append("a layer"))
    publish.submit()
    assert len(submitted) == 1
    assert published == []


def test_products_are_made_again_after_a_look_up(store):
    with pytest.raises(NotMadeError, match="slope"), looking_up():
        store.make(SLOPE, text("made"))
    assert store.path(store.make(SLOPE, text("made"))).read_text() == "made"
