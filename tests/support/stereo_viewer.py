"""The store of true images as a mission that the viewer shows.

Images and vector layers are added, an older solution that has the second stop a known step away
from where it is, and residuals that are known: those of the images are zero, so they are made up.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.terrain.visibility.footprints import FootprintParams
from solmap.products.catalogue.catalogue import latest_network
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.vector.geojson import read_features
from solmap.products.model import Layer, ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.tasks.mission.vectors import draw_vectors
from tests.support.panorama_store import publish_panoramas
from tests.unit.gis_server.stereo.stereo_store import LANDING, StereoStore, build_stereo_store

OLDER_STEP_NED_M = (0.30, -0.40, 0.05)
"""From the second stop to where the older solution has it."""
RESIDUAL_PX = (0.3, -0.4, 0.0)
"""Sample, line and parallax of every tie in its epipolar image."""


def fill(root: Path) -> StereoStore:
    """Build the store below `root`."""
    stereo = build_stereo_store(root)
    workspace = stereo.workspace
    entries = [replace(entry, browse=_image(entry, stereo)) for entry in stereo.entries]
    older = _changed_network(stereo, "older", _with_stop_moved)
    latest = _changed_network(stereo, "latest", _with_residuals)
    made = draw_vectors.fn("MER2", latest, entries, FootprintParams(), LANDING, workspace)
    layers = [_layer(ref, stereo) for ref in made]
    workspace.catalogue.publish(images=entries, layers=layers, pointers=[older, latest])
    publish_panoramas(workspace)
    return StereoStore(stereo.world, workspace)


def _image(entry, stereo: StereoStore) -> ProductRef:
    data = stereo.workspace.store.path(entry.ref).read_bytes()
    pixels = read_image(data, f"{entry.id}.IMG").pixels
    low, high = np.percentile(pixels, (0.5, 99.5))
    grey = np.clip((pixels - low) * (255.0 / (high - low)), 0, 255).astype(np.uint8)
    recipe = Recipe(ProductKind.BROWSE, Scope(ScopeLevel.IMAGE, entry.id.lower()), (), ("picture",))
    body = cv2.imencode(".png", grey)[1].tobytes()
    return stereo.workspace.store.make(recipe, lambda path: _keep(path, body))


def older_solution(workspace: Workspace) -> str:
    """Name of the older solution in the server's addresses."""
    scope = latest_network("MER2", workspace.catalogue).scope
    return f"{scope.name}/{_recipe(scope, 'older').ref.digest}"


def _recipe(scope: Scope, name: str) -> Recipe:
    return Recipe(ProductKind.NETWORK, scope, (), (name,))


def _changed_network(stereo: StereoStore, name: str, change) -> ProductRef:
    store, catalogue = stereo.workspace.store, stereo.workspace.catalogue
    true = latest_network("MER2", catalogue)
    document = json.loads(store.path(true).read_text())
    change(document["network"])
    body = json.dumps(document).encode()
    return store.make(_recipe(true.scope, name), lambda path: _keep(path, body))


def _with_stop_moved(network) -> None:
    pose = network["stops"][1]["lsl_from_rover"]
    pose["translation_m"] = (np.array(pose["translation_m"]) + OLDER_STEP_NED_M).tolist()


def _with_residuals(network) -> None:
    ties = network["ties"]
    ties["residuals_px"] = [list(RESIDUAL_PX) for _ in ties["residuals_px"]]


def _layer(ref: ProductRef, stereo: StereoStore) -> Layer:
    features = read_features(stereo.workspace.store.path(ref)).features
    boxes = np.array([feature.bounds for feature in features])
    bounds = (*boxes[:, :2].min(axis=0).tolist(), *boxes[:, 2:].max(axis=0).tolist())
    made_at = stereo.workspace.store.made_at(ref)
    title = str(ref.kind)
    return Layer(ref, "MER2", title, "vector", bounds, None, None, None, (156,), made_at)


def _keep(path: Path, body: bytes) -> None:
    path.write_bytes(body)
