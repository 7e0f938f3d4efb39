"""Kinds of products, and the names that recipes keep."""

import ast
import dataclasses
from pathlib import Path

import pytest

from solmap.products.model import (
    FAR_KINDS,
    REGION_KINDS,
    Layer,
    ProductKind,
    ProductRef,
    Scope,
    ScopeLevel,
    plain,
)
from solmap.products.recipe_names import RECIPE_NAMES, RecipeNames

PACKAGES = ("config", "photogrammetry", "products", "tasks")
ROOT = Path(__file__).parents[3]


@dataclasses.dataclass(frozen=True)
class Renamed:
    kept: int = 1
    new: float = 2.5


def classes():
    """Classes of the code, by name: bases, and annotated names. Importing them all takes long."""
    return {
        node.name: (
            [ast.unparse(base) for base in node.bases],
            {ast.unparse(one.target) for one in node.body if isinstance(one, ast.AnnAssign)},
        )
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef)
    }


def fields_of(name, known):
    bases, own = known[name]
    return own.union(*(fields_of(base, known) for base in bases if base in known))


def test_every_name_in_recipes_is_of_a_record_and_its_fields():
    known = classes()
    for name, names in RECIPE_NAMES.items():
        assert name in known, f"{name} is not a class any more: name its replacement"
        fields = fields_of(name, known)
        assert set(names.fields) <= fields, name
        assert not set(names.constants) & fields, name


def test_a_renamed_record_is_stored_under_its_former_names(monkeypatch):
    names = RecipeNames("Former", {"new": "old"}, {"gone": [1, 2]})
    monkeypatch.setitem(RECIPE_NAMES, "Renamed", names)
    assert plain(Renamed()) == {"": "Former", "kept": 1, "old": 2.5, "gone": [1, 2]}


@pytest.mark.parametrize(("kinds", "prefix"), [(FAR_KINDS, "far-"), (REGION_KINDS, "region-")])
def test_variants_of_a_map_have_its_format(kinds, prefix):
    assert kinds
    for kind, variant in kinds.items():
        assert variant == f"{prefix}{kind}"
        assert variant.suffix == kind.suffix


def test_kinds_are_their_names():
    assert {str(kind) for kind in ProductKind} == {kind.value for kind in ProductKind}
    assert all(kind.suffix.startswith(".") for kind in ProductKind)
    assert ProductKind("dtm") is ProductKind.DTM


@pytest.mark.parametrize(
    ("scope", "kind", "sols", "cell_m", "name", "title"),
    [
        (
            "mer2-site0010-drive0100",
            "dtm",
            (156,),
            0.04,
            "MER2_sol0156_site010_drive0100_dtm_4cm",
            "A map, sol 156, site 10 drive 100, 4 cm",
        ),
        (
            "mer2-region-site0010-drive0000",
            "region-slope",
            (155, 156, 160),
            0.005,
            "MER2_sol0155-0160_region_site010_drive0000_slope_5mm",
            "A map, sol 155-160, region site 10 drive 0, 5 mm",
        ),
        ("mer2", "traverse", (155, 156), None, "MER2_sol0155-0156_traverse", "A map, sol 155-156"),
        ("mer2", "orbital", (), 2.0, "MER2_orbital_2m", "A map, 2 m"),
        ("mer2-site0138-drive12345", "far-dtm", (9,), 1.28, None, None),
    ],
)
def test_layers_have_readable_names(scope, kind, sols, cell_m, name, title):
    ref = ProductRef(ProductKind(kind), Scope(ScopeLevel.STOP, scope), "0" * 16)
    box = (0.0, 0.0, 1.0, 1.0)
    layer = Layer(ref, "MER2", "A map", "raster", box, cell_m, None, None, sols, "2026-01-01")
    assert layer.readable_name == (name or "MER2_sol0009_site138_drive12345_far-dtm_128cm")
    assert layer.full_title == (title or "A map, sol 9, site 138 drive 12345, 128 cm")


def test_the_title_of_an_untied_layer_states_so():
    ref = ProductRef(ProductKind.DTM, Scope(ScopeLevel.STOP, "mer2-site0195-drive0002"), "0" * 16)
    box = (0.0, 0.0, 1.0, 1.0)
    layer = Layer(
        ref, "MER2-ORIGIN195", "Elevation", "raster", box, 0.04, None, None, (9,), "2026-01-01"
    )
    assert layer.readable_name == "MER2-ORIGIN195_sol0009_site195_drive0002_dtm_4cm"
    assert layer.full_title == (
        "Elevation, sol 9, site 195 drive 2, 4 cm, origin: site 195, not tied to the lander"
    )
