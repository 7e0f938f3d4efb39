"""Notes and extent of three-dimensional models, independent of their format."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Any

from solmap.products.crs import LandingPoint, height_reference, local_crs, local_proj4
from solmap.products.formats.mesh.gltf import box_of_glb
from solmap.products.formats.mesh.ply import read_ply
from solmap.products.formats.mesh.tiles3d import box_of, read_tileset
from solmap.products.model import Recipe


def notes_of(recipe: Recipe, landing: LandingPoint) -> dict[str, Any]:
    """Frame, CRS and provenance, as plain JSON values stored inside a model.

    The inputs name the terrain model and with it the adjustment of its pairs.
    """
    ref = recipe.ref
    return {
        "frame": f"local map of {landing.name}",
        "crs": local_crs(landing).to_wkt(),
        "proj4": local_proj4(landing),
        "vertical": height_reference(local_crs(landing)),
        "product": f"{ref.kind}/{ref.scope}/{ref.digest}",
        "inputs": recipe.document["inputs"],
        "science": recipe.science,
        "software": f"solmap {version('solmap')}",
    }


def extent_of_model(
    path: Path,
) -> tuple[tuple[float, float, float, float], tuple[float, float]]:
    """(west, south, east, north) and least and largest elevation of a model, metres."""
    if path.suffix == ".3tz":
        low, high = box_of(read_tileset(path)["root"]["boundingVolume"]["box"])
    elif path.suffix == ".ply":
        rows = read_ply(path)
        places = [rows[name] for name in "xyz"]
        x, y, z = ((float(along.min()), float(along.max())) for along in places)
        return (x[0], y[0], x[1], y[1]), z
    else:
        low, high = (tuple(corner.tolist()) for corner in box_of_glb(path.read_bytes()))
    return (low[0], low[1], high[0], high[1]), (low[2], high[2])
