"""Stages under Prefect's engine: what can pass is tried again, what cannot is not."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from photogrammetry.errors import MatchingError
from products.errors import StoreFullError
from products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from products.store import ProductStore

pytestmark = pytest.mark.usefixtures("engine")
RECIPE = Recipe(ProductKind.SLOPE, Scope(ScopeLevel.STOP, "mer2-site0001-drive0002"))


@pytest.fixture
def store(tmp_path: Path) -> ProductStore:
    return ProductStore.open(tmp_path / "store")


@pytest.fixture
def failing_disk(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A disk that answers `fsync` with the errors in the list, one after the other, then works."""
    errors: list[int] = []
    real = os.fsync

    def fsync(descriptor: int) -> None:
        if errors:
            raise OSError(errors[0], os.strerror(errors.pop(0)))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    return errors


def test_a_stage_is_tried_again_until_the_disk_works(
    store: ProductStore, failing_disk: list[int]
) -> None:
    failing_disk.extend([errno.EIO, errno.ESTALE])
    attempts: list[int] = []

    assert run(store, attempts, lambda path: path.write_text("whole")) == RECIPE.ref
    assert len(attempts) == 3
    assert store.path(RECIPE.ref).read_text() == "whole"
    assert not list((store.root / "drafts").iterdir())


def test_a_pair_without_texture_is_matched_once(store: ProductStore) -> None:
    attempts: list[int] = []

    def write(_path: Path) -> None:
        raise MatchingError("no texture")

    with pytest.raises(MatchingError, match="no texture"):
        run(store, attempts, write)
    assert len(attempts) == 1


def test_a_full_disk_is_not_tried_again(store: ProductStore, failing_disk: list[int]) -> None:
    failing_disk.append(errno.ENOSPC)
    attempts: list[int] = []

    with pytest.raises(StoreFullError, match="free some space and run again"):
        run(store, attempts, lambda path: path.write_text("whole"))
    assert len(attempts) == 1
    assert not store.has(RECIPE.ref)


def test_a_disk_that_stays_away_is_given_up(store: ProductStore, failing_disk: list[int]) -> None:
    from tasks.stage import RETRIES  # noqa: PLC0415 - after the engine's settings

    failing_disk.extend([errno.EIO] * 50)
    attempts: list[int] = []

    with pytest.raises(OSError, match="Input/output error"):
        run(store, attempts, lambda path: path.write_text("whole"))
    assert len(attempts) == RETRIES + 1


def run(store: ProductStore, attempts: list[int], write: Callable[[Path], object]) -> ProductRef:
    """Make the product in a stage of a flow, without the pauses."""
    from prefect import flow  # noqa: PLC0415 - after the engine's settings

    from tasks.stage import stage  # noqa: PLC0415

    @stage(task_run_name="slope-{name}")
    def make(name: str) -> ProductRef:  # noqa: ARG001 - names the run
        attempts.append(1)
        return store.make(RECIPE, write)

    @flow(name="retries")
    def make_it() -> ProductRef:
        return make.with_options(retry_delay_seconds=0).submit("a").result()

    return make_it()
