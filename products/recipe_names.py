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


RECIPE_NAMES: dict[str, RecipeNames] = {
    "CandidateParams": RecipeNames("Candidates"),
    "EditPoint": RecipeNames("HandPoint"),
    "EditRequest": RecipeNames("HandTie"),
    "FeatureParams": RecipeNames("WideBaselineParams"),
    "TieRefinementParams": RecipeNames("RefinementParams"),
    "DtmParams": RecipeNames(constants={"min_region_px": 100}),
    "FacetParams": RecipeNames(constants={"min_region_px": 100, "sigma_image_px": 0.25}),
    "FarDtmParams": RecipeNames(constants={"min_region_px": 100}),
    "HillshadeParams": RecipeNames(constants={"baseline_cells": 3}),
    "OrthophotoParams": RecipeNames(
        constants={
            "normal_baseline_m": 0.2,
            "sharpness": 8.0,
            "stretch_percent": [0.5, 99.5],
            "tolerance_px": 1.0,
        }
    ),
    "PanoramaParams": RecipeNames(
        constants={"most_pixels": 1 << 26, "sharpness": 8.0, "stretch_percent": [0.5, 99.5]}
    ),
    "PlanarRegionParams": RecipeNames("RegionParams", constants={"bow_px": 0.1, "flat_px": 0.2}),
    "PointCloudParams": RecipeNames(
        constants={"min_region_px": 100, "stretch_percent": [0.5, 99.5]}
    ),
    "RegionParams": RecipeNames(constants={"holes_m": 0.5}),
    "RegistrationParams": RecipeNames(
        constants={
            "half_square_m": 8.0,
            "halves_apart_cells": 3.0,
            "largest_sigma_cells": 1.0,
            "least_lead": 1.5,
            "other_place_m": 2.0,
        }
    ),
    "SearchParams": RecipeNames(constants={"reach_deg": 2.5, "step_deg": 0.25}),
    "SlopeParams": RecipeNames(constants={"correlation_m": 0.15}),
    "ViewModelParams": RecipeNames(
        constants={"gap_px": 4, "min_region_px": 100, "stretch_percent": [0.5, 99.5]}
    ),
}
"""By class name in the code."""
