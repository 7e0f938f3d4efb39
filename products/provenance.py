"""What a raster says inside itself about how it was made."""

from __future__ import annotations

import json
from importlib.metadata import version

from products.model import Recipe

SOFTWARE = f"solmap {version('solmap')}"


def provenance_tags(recipe: Recipe) -> dict[str, str]:
    """Tags with a product's name, inputs, parameters, software and version of the science.

    The parameters hold the adjusted orientations a map was made with, number by number, for a map
    depends on these and not on the network they came from.
    """
    document, ref = recipe.document, recipe.ref
    return {
        "PRODUCT": f"{ref.kind}/{ref.scope}/{ref.digest}",
        "INPUTS": " ".join(document["inputs"]),
        "PARAMETERS": json.dumps(document["params"], separators=(",", ":"), sort_keys=True),
        "SCIENCE_VERSION": str(recipe.science),
        "TIFFTAG_SOFTWARE": SOFTWARE,
    }
