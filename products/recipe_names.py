"""Names that recipes keep when the code's names change, so that stores stay valid.

A product's digest is that of its recipe, and the recipe names the classes and fields of its
parameters. Renaming a class, or turning a parameter that nobody set into a constant, changes no
product; an entry here keeps the recipe as it was. Entries go when `SCIENCE_VERSION` is raised.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class RecipeNames:
    """How one record is written in recipes."""

    name: str | None = None
    """Class name in recipes, if not the name in the code."""
    fields: dict[str, str] = field(default_factory=dict)
    """Field names in recipes, by their names in the code, where they differ."""
    constants: dict[str, Any] = field(default_factory=dict)
    """Values, as plain JSON, of fields that have become constants."""


RECIPE_NAMES: dict[str, RecipeNames] = {}
"""By class name in the code."""
