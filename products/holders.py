"""Who holds what a document does not hold itself: other products, by stop.

A sol changes a few stops of a mission. What it says of the others would be said again by every sol,
so a document of a sol names the earlier product that says it.
"""

from __future__ import annotations

from collections.abc import Mapping

from solmap.products.model import ProductRef

Holders = dict[str, ProductRef]
"""The product that holds a stop, by the name of the stop."""


def holders_document(holders: Mapping[str, ProductRef]) -> dict[str, str]:
    """As plain JSON, in the order of the stops."""
    return {name: ref.text for name, ref in sorted(holders.items())}


def holders_of_document(document: Mapping[str, str]) -> Holders:
    """The twin of `holders_document`."""
    return {name: ProductRef.of_text(text) for name, text in document.items()}
