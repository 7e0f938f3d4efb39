"""Pruning: remove unreferenced products; needed and recent ones are kept.

Needed are

- what a pointer of the catalogue names, and every image with its browse image and tables;
- what finished sols left, even if later ones mapped it again: while it is there, a rerun passes
  them over;
- of each kind and scope some versions before the published one, for comparison;
- what is younger than a given age: a run that was killed made it, and the next one will need it;
- what the recipes of all these name, and the recipes of those: a published map can be made again
  from what lies in the store;
- of kinds that no pointer ever names (quick-looks, ties, matches between stops) the newest that was
  made from needed products only: a rerun looks it up.

All others were made with earlier parameters or from earlier adjustments. They are removed from the
catalogue first, in one transaction, and then from the disk; if interrupted, the next pruning
completes it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

import sqlalchemy as sa

from solmap.products.catalogue.database import FINISHED, LABELS, LATEST, LAYERS, write_transaction
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, ProductNotFoundError
from solmap.products.model import ProductKind, ProductRef

UNPUBLISHED = {
    ProductKind.QUICKLOOK,
    ProductKind.LINKS,
    ProductKind.TIES,
    ProductKind.MATCHES,
    ProductKind.PARALLAX,
}
"""Kinds of which reruns look up some products although they are unreferenced."""


@dataclass(frozen=True, slots=True)
class PruningParams:
    """Products that are kept besides those needed."""

    versions: int = 2
    """Number per kind and scope: the published one, and those before it."""
    youngest: timedelta = timedelta(days=7)
    """Age below which products are kept."""

    def __post_init__(self) -> None:
        if self.versions < 1 or self.youngest < timedelta(0):
            raise ProductError(
                "pruning must keep at least one version, and the age must not be negative, but "
                f"{self.versions} versions and {self.youngest} were requested"
            )


@dataclass(frozen=True, slots=True)
class UnreferencedProduct:
    """A product that may be removed."""

    ref: ProductRef
    size: int
    """Bytes, without its provenance."""


@dataclass(frozen=True, slots=True)
class _Known:
    """Data of a product in the store."""

    ref: ProductRef
    inputs: tuple[str, ...]
    params: str
    """The class of its parameters: products that differ in it are not versions of each other."""
    made_at: str
    size: int


@dataclass(slots=True)
class _Needs:
    """The names of needed products, and of their inputs."""

    known: Mapping[str, _Known]
    names: set[str] = field(default_factory=set)

    def add(self, names: Iterable[str]) -> None:
        """Add products, their inputs, and so on."""
        waiting = [name for name in names if name in self.known]
        while waiting:
            name = waiting.pop()
            if name not in self.names:
                self.names.add(name)
                waiting += [one for one in self.known[name].inputs if one in self.known]


def unreferenced_products(workspace: Workspace, params: PruningParams) -> list[UnreferencedProduct]:
    """The unreferenced products of a store, by kind, scope and digest; removes nothing."""
    known = dict(_known_products(workspace))
    needs = _Needs(known)
    published = set(_published_names(workspace))
    needs.add(published)
    youngest = (datetime.now(UTC) - params.youngest).isoformat(timespec="seconds")
    needs.add(name for name, one in known.items() if one.made_at > youngest)
    needs.add(_versions(known, published, params.versions))
    while found := list(_newest_unpublished(known, needs.names)):
        needs.add(found)
    return [
        UnreferencedProduct(one.ref, one.size)
        for name, one in known.items()
        if name not in needs.names
    ]


def prune(workspace: Workspace, params: PruningParams) -> list[UnreferencedProduct]:
    """Remove the unreferenced products, and return them.

    Raises:
        StoreBusyError: a run is in progress, which may still need them.
    """
    with workspace.maintenance_turn("prune"):
        found = unreferenced_products(workspace, params)
        _forget(workspace, [one.ref for one in found])
        for one in found:
            workspace.store.remove(one.ref)
    return found


def _known_products(workspace: Workspace) -> Iterator[tuple[str, _Known]]:
    store = workspace.store
    for ref in store.refs():
        try:
            yield _name(ref), _known(ref, store.provenance(ref))
        except (ProductNotFoundError, ValueError, LookupError, TypeError):
            continue  # products of unknown origin are kept; `solmap check` lists them


def _known(ref: ProductRef, notes: dict[str, Any]) -> _Known:
    recipe = notes["recipe"]
    inputs = (*recipe["inputs"], *_named_in(recipe["params"]))
    params = recipe["params"]
    sort = params.get("", "") if isinstance(params, dict) else ""
    return _Known(ref, inputs, sort, notes["made_at"], notes["bytes"])


def _named_in(params: Any) -> Iterator[str]:  # noqa: ANN401 - plain JSON
    """Products named in parameters, as written by `products.model.plain`."""
    if isinstance(params, dict):
        if params.get("") == ProductRef.__name__:
            yield f"{params['kind']}/{params['scope']['name']}/{params['digest']}"
        for value in params.values():
            yield from _named_in(value)
    elif isinstance(params, list):
        for value in params:
            yield from _named_in(value)


def _published_names(workspace: Workspace) -> Iterator[str]:
    """The products of pointers and of finished sols, and the images."""
    with workspace.catalogue.engine.connect() as connection:
        for row in connection.execute(sa.select(LATEST)):
            yield f"{row.kind}/{row.scope}/{row.digest}"
        finished = connection.execute(sa.select(FINISHED.c.document)).scalars().all()
    for document in finished:
        for text in (*document["standing"], *document["layers"], *document.get("pointers", ())):
            kind, _, rest = text.partition("/")  # a scope may have an odd name
            yield f"{kind}/{rest.partition('/')[2]}"
    for image in workspace.catalogue.images():
        for ref in (image.ref, image.browse, image.radiometry):
            if ref is not None:
                yield _name(ref)


def _versions(known: Mapping[str, _Known], published: set[str], count: int) -> Iterator[str]:
    """The newest versions besides the published ones, of each published kind and scope."""
    earlier: dict[tuple[str, str], list[_Known]] = {}
    pointed = {tuple(name.split("/")[:2]) for name in published}
    for name, one in known.items():
        key = str(one.ref.kind), one.ref.scope.name
        if key in pointed and name not in published:
            earlier.setdefault(key, []).append(one)
    for versions in earlier.values():
        versions.sort(key=lambda one: (one.made_at, one.ref.digest), reverse=True)
        yield from (_name(one.ref) for one in versions[: count - 1])


def _newest_unpublished(known: Mapping[str, _Known], needed: set[str]) -> Iterator[str]:
    """The newest unpublished product of each sort made only from needed products."""
    newest: dict[tuple[object, ...], _Known] = {}
    for one in known.values():
        if one.ref.kind in UNPUBLISHED and one.inputs and needed.issuperset(one.inputs):
            made_from = tuple(sorted(name.rpartition("/")[0] for name in one.inputs))
            sort = (one.ref.kind, one.ref.scope.name, one.params, made_from)
            if sort not in newest or newest[sort].made_at <= one.made_at:
                newest[sort] = one
    names = (_name(one.ref) for one in newest.values())
    return (name for name in names if name not in needed)


def _forget(workspace: Workspace, refs: Iterable[ProductRef]) -> None:
    """Remove layers, and the labels of images, from the catalogue, in one transaction."""
    with write_transaction(workspace.catalogue.engine) as connection:
        for ref in refs:
            connection.execute(
                LAYERS.delete().where(
                    LAYERS.c.scope == ref.scope.name,
                    LAYERS.c.kind == str(ref.kind),
                    LAYERS.c.digest == ref.digest,
                )
            )
            if ref.kind is ProductKind.IMAGE:
                of_image = LABELS.c.digest.startswith(f"{ref.digest}/", autoescape=True)
                connection.execute(LABELS.delete().where(of_image))


def _name(ref: ProductRef) -> str:
    return f"{ref.kind}/{ref.scope.name}/{ref.digest}"
