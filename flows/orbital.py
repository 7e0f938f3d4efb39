"""An orbital image becomes the base of the map, registered to what the rover mapped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from config.landing import landing_site
from config.settings import Settings
from photogrammetry.orbital.registration import RegistrationParams
from photogrammetry.terrain.grid import union
from products.catalogue import MissionEntry
from products.errors import ProductNotFoundError
from products.model import Layer, ProductKind, ScopeLevel
from products.workspace import Workspace
from tasks.orbital import (
    StopMap,
    draw_base,
    read_registration,
    register_orbital,
    take_orbital,
)
from tasks.publish import publish


def add_orbital(file: Path, mission: str, root: Path, *, registered: bool = True) -> str:
    """Register an orbital image to a mission's stops and publish it as base layer; what came of it.

    Raises:
        ProductError: the file cannot be read or lies elsewhere; or no stop is mapped.
    """
    workspace = Workspace.open(root)
    store = workspace.store
    site = landing_site(mission, Settings().landing_sites)
    layers = [layer for layer in workspace.catalogue.layers() if layer.mission == mission]
    stops = _stops(layers)
    if not stops:
        raise ProductNotFoundError(f"no stop of {mission} is mapped; `solmap run` its downlink")
    image = take_orbital(file, store)
    registration = None
    said = f"{file.name} lies where it claims to"
    if registered:
        params = RegistrationParams()
        registration = register_orbital.fn(image, stops, params, site.landing, store)
        said = f"{file.name}: {_said(read_registration(registration, store))}"
    around = union(layer.bounds for layer in layers if layer.ref.kind is ProductKind.DTM)
    base = draw_base.fn(mission, image, registration, around, site.landing, store)
    sols = tuple(sorted({sol for layer in layers for sol in layer.sols}))
    entry = MissionEntry(mission, site.title, site.landing, None)
    pointers = [image] if registration is None else [image, registration]
    publish.fn(entry, [(base, sols)], pointers, (), workspace)
    return said


def _stops(layers: list[Layer]) -> list[StopMap]:
    by_stop = {
        kind: {layer.ref.scope: layer.ref for layer in layers if layer.ref.kind is kind}
        for kind in (ProductKind.DTM, ProductKind.ORTHOPHOTO)
    }
    dtms, pictures = by_stop.values()
    return [
        StopMap(dtm, pictures[scope])
        for scope, dtm in sorted(dtms.items())
        if scope in pictures and scope.level is ScopeLevel.STOP
    ]


def _said(found: dict[str, Any]) -> str:
    if found["correction"] is None:
        return f"not registered, it lies where it claims to: {found['reason']}"
    correction = found["correction"]
    variances = [correction["covariance"][k][k] for k in range(3)]
    east, north, turn = (variance**0.5 for variance in variances)
    return (
        f"moved by {correction['east_m']:+.2f} m east and {correction['north_m']:+.2f} m north "
        f"(1 sigma {east:.2f} and {north:.2f} m), turned by {correction['rotation_deg']:+.3f} "
        f"degrees ({turn * 57.29578:.3f}); it explains {found['explained']:.0%} of the image, "
        f"the best other place {found['runner_up']:.0%}"
    )
