"""Names in recipes that stay when names in the code change, so that stores remain valid.

A product's digest is that of its recipe, and the recipe names the classes and fields of its
parameters. Renaming a class, or replacing an unused parameter by a constant, changes no product; an
entry here keeps the recipe unchanged. Entries are removed when `SCIENCE_VERSION` is raised.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class RecipeNames:
    """Names and values of one record in recipes."""

    name: str | None = None
    """Class name in recipes, if not the name in the code."""
    fields: dict[str, str] = field(default_factory=dict)
    """Field names in recipes, by their names in the code, where they differ."""
    constants: dict[str, Any] = field(default_factory=dict)
    """Values, as plain JSON, of fields that have become constants."""


RECIPE_NAMES: dict[str, RecipeNames] = {}
"""Names in recipes by class name in the code."""
