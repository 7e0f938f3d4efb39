"""Provenance of a product: tags inside rasters, and the adjustment that it depends on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

from solmap.products.errors import ProductNotFoundError
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore

SOFTWARE = f"solmap {version('solmap')}"
_ADJUSTED = {"Orientation"}
"""Records of a recipe that are results of an adjustment."""


def provenance_tags(recipe: Recipe) -> dict[str, str]:
    """Tags with a product's name, inputs, parameters, software and version of the science.

    The parameters contain the adjusted orientations of a map, number by number, because a map
    depends on these and not on their network; `ADJUSTMENT` names them.
    """
    document, ref = recipe.document, recipe.ref
    adjustment = orientations_id(document["params"])
    return {
        "PRODUCT": f"{ref.kind}/{ref.scope}/{ref.digest}",
        "INPUTS": " ".join(document["inputs"]),
        "PARAMETERS": json.dumps(document["params"], separators=(",", ":"), sort_keys=True),
        "SCIENCE_VERSION": str(recipe.science),
        "TIFFTAG_SOFTWARE": SOFTWARE,
        **({"ADJUSTMENT": adjustment} if adjustment else {}),
    }


def adjustment_id(ref: ProductRef, store: ProductStore) -> str | None:
    """The adjustment of a product: the digest of its orientations, or its network.

    Products of one stop with equal names were made from the same orientations. None for products
    without adjustment, or with missing inputs.
    """
    try:
        recipe = store.provenance(ref)["recipe"]
    except ProductNotFoundError:
        return None
    named = orientations_id(recipe["params"])
    if named:
        return named
    for text in recipe["inputs"]:
        kind, scope, digest = text.split("/")
        if kind == ProductKind.NETWORK:
            return str(text)
        earlier = ProductRef(ProductKind(kind), Scope(ScopeLevel.STOP, scope), digest)
        found = adjustment_id(earlier, store)
        if found:
            return found
    return None


def orientations_id(params: Any) -> str | None:  # noqa: ANN401 - plain JSON
    """A name for the orientations in some parameters; None where there are none."""
    rows = list(orientation_records(params))
    if not rows:
        return None
    text = json.dumps(rows, sort_keys=True, separators=(",", ":"))
    return f"orientations-{hashlib.sha256(text.encode()).hexdigest()[:16]}"


def orientation_records(value: Any) -> Iterator[dict[str, Any]]:  # noqa: ANN401 - plain JSON
    """The records of adjusted orientations in the parameters of a recipe."""
    if isinstance(value, dict):
        if value.get("") in _ADJUSTED:
            yield value
        else:
            for part in value.values():
                yield from orientation_records(part)
    elif isinstance(value, list):
        for part in value:
            yield from orientation_records(part)
