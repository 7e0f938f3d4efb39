"""Makes and publishes products one after the other, as a flow does: `... product_keeper STORE`."""

import sys
from pathlib import Path

from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, Recipe, Scope, ScopeLevel

STOP = Scope(ScopeLevel.STOP, "mer2-site0010-drive0000")
PRODUCTS = 250


def keep_products(root: Path) -> None:
    """Into the store at `root`."""
    workspace = Workspace.open(root)
    for number in range(PRODUCTS):
        recipe = Recipe(ProductKind.SLOPE, STOP, params=(number,))
        data = bytes([number]) * (200 * number)
        ref = workspace.store.make(recipe, lambda path, data=data: path.write_bytes(data))
        workspace.catalogue.publish(pointers=[ref])


if __name__ == "__main__":
    keep_products(Path(sys.argv[1]))
