"""Data from elsewhere, added by a command: orbital images, measured control, manual ties."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from solmap.config.landing import LandingSite, landing_site
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.runtime.run_record import beside_runs
from solmap.photogrammetry.archive.tables.places import ORBITAL, PRIORITY
from solmap.photogrammetry.archive.tables.vector_files import Solution, VectorFile
from solmap.photogrammetry.frames import FrameKind
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.manual.editing import EditAction
from solmap.photogrammetry.orbital.registration import RegistrationParams
from solmap.photogrammetry.orbital.search import SearchParams
from solmap.photogrammetry.terrain.dtm.grid import union
from solmap.products.catalogue.catalogue import MissionEntry, Outcome, published_networks
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import east_north, local_crs
from solmap.products.errors import ProductError, ProductNotFoundError
from solmap.products.formats.documents.control import read_control, refused_stops
from solmap.products.formats.raster.raster import bounds_on_map
from solmap.products.model import (
    Layer,
    ProductKind,
    ProductRef,
    ScopeLevel,
    mission_of,
    origin_of,
)
from solmap.products.store.product_store import ProductStore
from solmap.products.store.user_files import MAX_ROWS_BYTES, read_user_file
from solmap.tasks.images.manual_ties import named_in, read_edit_requests, take_manual_ties
from solmap.tasks.images.poses import open_pose_sources, take_poses
from solmap.tasks.mission.control import (
    FrameParams,
    control_by_image,
    control_of,
    take_control,
)
from solmap.tasks.mission.orbital import (
    AssumedOrigin,
    RegisteredImage,
    RegistrationMethod,
    StopMap,
    draw_base,
    find_origin,
    read_registration,
    register_orbital,
    take_orbital,
)
from solmap.tasks.mission.publish import publish
from solmap.tasks.network.orientations import Standing, standing_of
from solmap.tasks.scopes import stop_of


@dataclass(frozen=True, slots=True)
class OrbitalOptions:
    """Options of adding an orbital image."""

    registered: bool = True
    """Find its place, rather than trust its georeference."""
    reach_m: float = SearchParams().reach_m
    """Largest error of its georeference."""
    control: FrameParams | None = field(default_factory=FrameParams)
    """Find every stop in it on its own, as control for the adjustment; None: do not."""
    heights: bool = False
    """Whether it is a terrain model, which gives control but no image to draw."""
    near_deg: tuple[float, float] | None = None
    """Longitude and latitude about which a map is looked for that is not tied to the lander; by
    default the middle of the image."""


@beside_runs
def add_orbital(
    file: Path, mission: str, root: Path, options: OrbitalOptions | None = None
) -> tuple[str, ...]:
    """Register an orbital image to a mission's stops and publish it as base layer.

    Raises:
        ProductError: the file cannot be read or lies elsewhere; or no stop is mapped.
    """
    workspace, options = open_workspace(root), options or OrbitalOptions()
    store = workspace.store
    site = _site_on_mars(mission)
    layers = [layer for layer in workspace.catalogue.layers() if layer.mission == mission]
    stops = _stops(layers, mission)
    if not stops:
        raise ProductNotFoundError(f"no stop of {mission} is mapped; `solmap run` its downlink")
    image = take_orbital(file, store)
    pointers, registration = [image], None
    lines = [f"{file.name} lies where it claims to"]
    if options.registered:
        search = SearchParams(reach_m=options.reach_m)
        params = RegistrationMethod(RegistrationParams(search), heights=options.heights)
        maps = list(stops.values())
        registration = register_orbital.fn(image, maps, params, site.landing, store)
        pointers.append(registration)
        lines = [f"{file.name}: {_registration_line(read_registration(registration, store))}"]
        standing = latest_standing(mission, workspace)
        if standing is not None and options.control is not None:
            how, registered = (params, options.control), RegisteredImage(image, registration)
            control = control_by_image.fn(registered, stops, standing, how, site.landing, store)
            pointers.append(control)
            lines += _control_lines(control, stops, store)
    entry = MissionEntry(mission, site.title, site.landing, None)
    if options.heights:
        publish.fn(entry, [], pointers, (), workspace).check()
        return tuple(lines)
    around = union(layer.bounds for layer in layers if layer.ref.kind is ProductKind.DTM)
    base = draw_base.fn(mission, image, registration, around, site.landing, store)
    sols = tuple(sorted({sol for layer in layers for sol in layer.sols}))
    publish.fn(entry, [(base, sols)], pointers, (), workspace).check()
    return tuple(lines)


@beside_runs
def tie_by_image(
    file: Path, name: str, root: Path, options: OrbitalOptions
) -> tuple[str, VectorFile]:
    """Find a map that is not tied to the lander in an orbital image.

    Args:
        file: The image, or terrain model.
        name: The map.
        root: Folder of the store.
        options: Options of the search.

    Returns:
        The result, and the site vector file that ties the map.

    Raises:
        ProductError: the file cannot be read, no stop is mapped, or the position is undecided.
    """
    workspace, sites = open_workspace(root), Settings().landing_sites
    landing, lander = (landing_site(one, sites).landing for one in (name, mission_of(name)))
    site, *drive = origin_of(name)
    if drive or not options.registered:
        raise ProductError(
            f"the map {name} cannot be tied by an orbital image "
            f"{'of the site of one stop alone' if drive else 'that is not registered'}; tie it by "
            "`solmap run --places FILE`"
        )
    stops = _stops([one for one in workspace.catalogue.layers() if one.mission == name], name)
    if not stops:
        raise ProductNotFoundError(f"no stop of {name} is mapped; `solmap run` its downlink")
    image = take_orbital(file, workspace.store)
    shown, _ = bounds_on_map(workspace.store.path(image), local_crs(lander))
    west, south, east, north = shown
    about_m = (west + east) / 2, (south + north) / 2
    if options.near_deg is not None:
        at_east, at_north = east_north(lander, *options.near_deg)
        about_m = float(at_east[0]), float(at_north[0])
    params = RegistrationMethod(
        RegistrationParams(SearchParams(reach_m=options.reach_m)), heights=options.heights
    )
    origin = AssumedOrigin(lander, about_m)
    found = find_origin(image, list(stops.values()), params, landing, origin, workspace.store)
    if found.registration.correction is None:
        raise ProductError(
            f"{file.name} does not locate {name}: {found.registration.reason}; the search covered "
            f"{options.reach_m:g} m of the "
            f"{'place given' if options.near_deg else 'middle of the image'} (--near, --reach)"
        )
    sigma_m = math.hypot(found.sigma_m, (options.control or FrameParams()).shift_m)
    east_m, north_m = found.place_m
    line = (
        f"site {site} lies {east_m:.1f} m east and {north_m:.1f} m north of the lander by "
        f"{file.name} (1 sigma {found.sigma_m:.2f} m in the image, {sigma_m:.1f} m with that of "
        f"its georeference, --shift-sigma); heights count from site {site}"
    )
    solution = Solution(
        ORBITAL,
        FrameKind.SITE,
        (site,),
        0,
        np.array([north_m, east_m, 0.0]),
        np.array([1.0, 0.0, 0.0, 0.0]),
        datetime.now(UTC).isoformat(timespec="seconds"),
        sigma_m,
    )
    source = f"{file.stem}-site{site}.svf"
    return line, VectorFile(source, mission_of(name), "svf", PRIORITY, (solution,))


def _site_on_mars(name: str) -> LandingSite:
    """The landing site of a map.

    Raises:
        ProductError: the map is not tied to the lander.
    """
    site = landing_site(name, Settings().landing_sites)
    if site.landing.origin:
        raise ProductError(
            f"the map {name} has its {site.landing.name}: positions on Mars cannot be used; tie "
            f"it by `solmap orbital add IMAGE --mission {name}` or `solmap run --places FILE`, a "
            "PLACES table, site vector file or poses (`solmap poses add FILE` takes the same)"
        )
    return site


def latest_standing(mission: str, workspace: Workspace) -> Standing | None:
    """The latest network of a mission with the orientations of its maps, if there is one."""
    networks = published_networks(mission, workspace.catalogue)
    return standing_of(networks[-1], workspace) if networks else None


def _control_lines(
    control: ProductRef, stops: dict[StopId, StopMap], store: ProductStore
) -> list[str]:
    """Results of locating every stop separately."""
    _, found = read_control(control, store)
    lines = [
        f"found on their own: {len(found)} of {len(stops)} stops; `solmap adjust` weighs "
        "their places in"
    ]
    refused = refused_stops(control, store)
    return lines + [f"{stop} not found: {reason}" for stop, reason in refused.items()]


def _stops(layers: list[Layer], mission: str) -> dict[StopId, StopMap]:
    by_stop = {
        kind: {layer.ref.scope: layer.ref for layer in layers if layer.ref.kind is kind}
        for kind in (ProductKind.DTM, ProductKind.ORTHOPHOTO)
    }
    dtms, orthophotos = by_stop.values()
    return {
        stop_of(scope, mission): StopMap(dtm, orthophotos[scope])
        for scope, dtm in sorted(dtms.items())
        if scope in orthophotos and scope.level is ScopeLevel.STOP
    }


def _registration_line(found: dict[str, Any]) -> str:
    if found["correction"] is None:
        return f"not registered, it lies where it claims to: {found['reason']}"
    correction = found["correction"]
    variances = [correction["covariance"][k][k] for k in range(4)]
    east, north, turn, scale = (variance**0.5 for variance in variances)
    return (
        f"moved by {correction['east_m']:+.2f} m east and {correction['north_m']:+.2f} m north "
        f"(1 sigma {east:.2f} and {north:.2f} m), turned by {correction['rotation_deg']:+.3f} "
        f"degrees ({turn * 57.29578:.3f}) and scaled by {1 + correction['scale']:.4f} ({scale:.4f})"
        f"{_height_change(correction)}, against the rover's map; it explains "
        f"{found['explained']:.0%} of the image, the best other place {found['runner_up']:.0%}"
    )


def _height_change(correction: dict[str, Any]) -> str:
    if correction.get("up_m") is None:
        return ""
    return f", raised by {correction['up_m']:+.2f} m ({correction['sigma_up_m']:.2f})"


@beside_runs
def add_control(file: Path, mission: str, root: Path, params: FrameParams) -> str:
    """Publish a file of measured control; one line on what it holds.

    Raises:
        AdjustmentError: the file is broken, or names a stop that is not known.
        ProductNotFoundError: no network of the mission is in the store.
    """
    workspace = open_workspace(root)
    site = _site_on_mars(mission)
    standing = latest_standing(mission, workspace)
    if standing is None:
        raise ProductNotFoundError(
            f"no network of {mission} is in the store; `solmap run` its downlink first"
        )
    store, data = workspace.store, read_user_file(file, most_bytes=MAX_ROWS_BYTES)
    ref = take_control(file.name, data, standing.network, params, site.landing, store)
    entry = MissionEntry(mission, site.title, site.landing, None)
    publish.fn(entry, [], [ref], (), workspace).check()
    frame, found = read_control(ref, store)
    if not found:
        return f"{file.name} is empty: what it held before counts no more"
    return f"{frame.name}: {len(found)} places; `solmap adjust` weighs them in"


@beside_runs
def add_poses(files: Sequence[Path], mission: str, root: Path) -> list[str]:
    """Take PLACES tables, location files, vector files, poses CSV or SPICE kernels; a line on each.

    Raises:
        VectorFileError: a file is none of them, or a row is broken.
    """
    with open_pose_sources(files) as sources:
        return take_poses(sources, mission_of(mission), open_workspace(root))


def control_rows(mission: str, root: Path) -> list[dict[str, Any]]:
    """Every control point of a stop."""
    workspace = open_workspace(root)
    rows = []
    for ref in control_of(mission, workspace):
        frame, control = read_control(ref, workspace.store)
        rows += [
            {
                "frame": frame.name,
                "stop": str(one.stop),
                "east_m": round(one.east_m, 3),
                "north_m": round(one.north_m, 3),
                "sigma_m": round(float(one.covariance[:2, :2].trace() / 2) ** 0.5, 3),
                "up_m": one.up_m,
                "azimuth_deg": one.azimuth_deg and round(one.azimuth_deg, 3),
            }
            for one in control
        ]
    return rows


@dataclass(frozen=True, slots=True)
class TakenTies:
    """Content of a file of manual ties."""

    name: str
    counts: dict[EditAction, int]
    unknown: tuple[str, ...]
    """Images and stops named in it that the store does not have yet."""

    def __str__(self) -> str:
        counts = ", ".join(f"{count} to {action}" for action, count in self.counts.items())
        return f"{self.name}: {counts}; the next run carries them out"


@beside_runs
def take_ties_file(file: Path, root: Path) -> TakenTies:
    """Take a file of manual ties into the store at `root`; an earlier one of its name is replaced.

    Raises:
        PhotogrammetryError: the file cannot be read; the message names the place and the reason.
        OSError: there is no such file.
    """
    data = read_user_file(file, most_bytes=MAX_ROWS_BYTES)
    requests = read_edit_requests(data, file.name)
    workspace = open_workspace(root)
    ref = take_manual_ties(file.name, data, workspace.store)
    entries = workspace.catalogue.images()
    known = {entry.id for entry in entries} | {entry.stop for entry in entries}
    counts = {action: sum(one.action is action for one in requests) for action in EditAction}
    taken = TakenTies(file.name, counts, tuple(sorted(named_in(requests) - known)))
    workspace.catalogue.publish(
        pointers=[ref],
        outcomes=[Outcome.now(file.name, (str(taken),))],
    )
    return taken
