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
    "AdjustmentParams": RecipeNames(
        constants={
            "false_share": 0.1,
            "far_parallax_px": 3.0,
            "gross": 4.0,
            "huber": 2.8,
            "max_halvings": 8,
            "robust_tolerance": 1.0,
        }
    ),
    "QualityParams": RecipeNames(constants={"fewest_in_cell": 5, "grid_cells": 8}),
    "AlignmentParams": RecipeNames(constants={"first_scale": 64.0, "rounds": 14}),
    "CandidateParams": RecipeNames(
        "Candidates",
        constants={
            "apart_cells": 5.0,
            "coarsest_cell_m": 1.0,
            "finest_cell_m": 0.05,
            "first_gap": {"": "Gap", "across_m": 0.15},
            "footprints": 1.5,
            "last_gap": {"": "Gap", "across_m": 0.05},
            "visible_px": 2.0,
            "widest_window": 24,
            "window_sigmas": 2.5,
        },
    ),
    "ConjugateParams": RecipeNames(
        constants={"iterations": 6, "largest_shift_px": 2.5, "largest_stretch": 0.35}
    ),
    "DenseParams": RecipeNames(constants={"normalisation_px": 31}),
    "EditPoint": RecipeNames("HandPoint"),
    "EditRequest": RecipeNames("HandTie"),
    "FoerstnerParams": RecipeNames(constants={"separation_px": 3}),
    "GroundMatchingParams": RecipeNames(constants={"blur_cells": 0.7, "first_sigma_px": 0.1}),
    "LeastSquaresParams": RecipeNames(constants={"furthest_px": 1.5, "settled_px": 0.005}),
    "MonoParams": RecipeNames(constants={"least_base_m": 0.01, "relief_px": 4}),
    "OrientationParams": RecipeNames(constants={"fewest_points": 30}),
    "RefinementParams": RecipeNames(constants={"furthest_px": 1.5, "texture_px": 5}),
    "SparseParams": RecipeNames(
        constants={"relief": {"": "ReliefParams", "neighbours": 25, "own_weight": 0.15}}
    ),
    "SurfaceParams": RecipeNames(
        constants={"least_facing": 0.05, "least_turned": 0.03, "range_ratio": 2.0}
    ),
    "SurfaceTieParams": RecipeNames(constants={"block_share": 0.06}),
    "TrialParams": RecipeNames(
        constants={
            "refinement": {
                "": "RefinementParams",
                "facet": {
                    "": "ConjugateParams",
                    "ambiguity": 1.0,
                    "half_px": 8,
                    "iterations": 6,
                    "largest_shift_px": 2.5,
                    "largest_stretch": 0.35,
                    "parallax_floor_px": 0.2,
                    "sigma_floor_px": 0.25,
                    "threshold": 0.6,
                },
                "reach": 3,
            }
        }
    ),
    "VerificationParams": RecipeNames(constants={"curve_points": 31, "neighbours": 12}),
    "WideParams": RecipeNames(
        constants={
            "search": {
                "": "AreaSearchParams",
                "interest": {
                    "": "FoerstnerParams",
                    "cell_px": 32,
                    "count": 1200,
                    "separation_px": 3,
                    "smallest_roundness": 0.5,
                    "smallest_weight": 0.1,
                    "window_px": 7,
                },
                "least_correlation": 0.8,
                "lines": 6,
                "window_px": 15,
            },
            "smoothing_px": 6.0,
        }
    ),
    "DtmParams": RecipeNames(constants={"min_region_px": 100}),
    "FacetParams": RecipeNames(constants={"min_region_px": 100, "sigma_image_px": 0.25}),
    "FarDtmParams": RecipeNames(constants={"min_region_px": 100}),
    "HillshadeParams": RecipeNames(constants={"baseline_cells": 3}),
    "MissionPlan": RecipeNames(
        constants={
            "control_sigma_m": 0.25,
            "cross_ties": 20,
            "far_cross_ties": 6,
            "fine_every": 10,
            "gap_drives": 2,
            "least_slip": 0.01,
            "most_slip": 0.2,
        }
    ),
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
