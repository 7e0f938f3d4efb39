"""Inputs of the processing of a sol or of a whole mission."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from solmap.config.landing import landing_site
from solmap.config.pipeline import PipelineConfig, load_pipeline
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.runtime.failures import keep_going
from solmap.photogrammetry.adjustment.model.network import StopPrior
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode
from solmap.photogrammetry.adjustment.model.variance_components import COMPONENTS, Component
from solmap.photogrammetry.archive.missions import mission_id
from solmap.photogrammetry.archive.tables.vector_files import VectorFile
from solmap.photogrammetry.errors import FrameError
from solmap.photogrammetry.frames import LSL, Pose, rover_frame, site_frame
from solmap.photogrammetry.imagery import RoverImage, StopId
from solmap.photogrammetry.matching.cross_site.gate import link_candidates
from solmap.photogrammetry.traverse.plausibility import (
    TelemetryStop,
    implausible_poses,
    implausible_stops,
)
from solmap.products.catalogue.catalogue import ImageEntry, MissionEntry
from solmap.products.catalogue.edits import EditLog
from solmap.products.catalogue.events import EDITS_CHANGED
from solmap.products.catalogue.images import image_record, image_records
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductKind, mission_of, origin_of, untied_map
from solmap.tasks.images.telemetry import Telemetry, read_telemetry, read_vector_file
from solmap.tasks.network.orientations import Standing

WINDOW = 3
"""Earlier stops that a sol may change: as far back as `adjust_stepwise` reaches."""


@dataclass(frozen=True, slots=True, eq=False)
class SolInputs:
    """Inputs of the processing of a sol, or of all sols up to one together."""

    workspace: Workspace
    pipeline: str
    """Name or path of `config`."""
    config: PipelineConfig
    mission: MissionEntry
    sol: int
    mode: AdjustmentMode
    telemetry: Telemetry
    new_stops: tuple[StopId, ...]
    """Stops first seen this sol."""
    touched: tuple[StopId, ...]
    """Stops of the images of this sol."""
    unplaced: tuple[str, ...]
    """Reasons why stops and images of this sol cannot be mapped, one line each."""
    unread: Mapping[str, str]
    """Causes of images and files that could not be read."""
    unpaired: tuple[ImageEntry, ...]
    """Images of this sol that have no stereo partner."""
    window: tuple[StopPrior, ...]
    """Stops whose orientation this sol may change, and those linked to them."""
    images: tuple[ImageEntry, ...]
    """Pairs taken at the stops of the window, up to this sol."""

    @property
    def landing(self) -> LandingPoint:
        """Origin of the map, and its position on Mars."""
        return self.mission.landing


def gather(
    mission: str, sol: int, store: Path, pipeline: str, previous: Standing | None = None
) -> SolInputs:
    """Read settings, labels and vector files, for the adjustment of a sol after `previous`."""
    known = _Known.of(mission, sol, store, pipeline, previous)
    stops, entries = known.telemetry.stops, known.entries
    touched = [stop for stop in stops if sol in stop.sols]
    window = _window(touched, stops, known, previous)
    seen = {entry.stop for entry in entries if entry.sol == sol}
    return SolInputs(
        known.workspace,
        pipeline,
        known.config,
        known.mission,
        sol,
        _mode(known.config),
        known.telemetry,
        tuple(stop.stop for stop in touched if stop.sols[0] == sol),
        tuple(stop.stop for stop in touched),
        (
            *(why for stop, why in known.telemetry.unplaced.items() if str(stop) in seen),
            *(why for entry, why in known.left_out if entry.sol == sol),
            *((known.mission.lsl_note or "",) if len(origin_of(mission)) > 1 else ()),
        ),
        known.unread,
        tuple(entry for entry in entries if entry.sol == sol and entry.partner is None),
        window,
        known.images_at(window),
    )


def gather_all(
    mission: str, sol: int, store: Path, pipeline: str, previous: Standing | None = None
) -> SolInputs:
    """Inputs of the overall adjustment of all stops up to a sol."""
    known = _Known.of(mission, sol, store, pipeline, previous)
    stops = known.telemetry.stops
    return SolInputs(
        known.workspace,
        pipeline,
        known.config,
        known.mission,
        sol,
        AdjustmentMode.OVERALL,
        known.telemetry,
        new_stops=(),
        touched=tuple(stop.stop for stop in stops),
        unplaced=tuple(known.telemetry.unplaced.values()),
        unread=known.unread,
        unpaired=(),
        window=stops,
        images=known.images_at(stops),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """Data of a mission up to a sol from the store and the settings."""

    workspace: Workspace
    config: PipelineConfig
    mission: MissionEntry
    entries: tuple[ImageEntry, ...]
    telemetry: Telemetry
    unread: Mapping[str, str]
    left_out: Sequence[tuple[ImageEntry, str]]

    @classmethod
    def of(
        cls, mission: str, sol: int, store: Path, pipeline: str, previous: Standing | None
    ) -> _Known:
        workspace = open_workspace(store)
        read = read_map(mission, workspace)
        entries = tuple(entry for entry, _ in read.images if entry.sol <= sol)
        config = _open_gate(load_pipeline(pipeline), previous, workspace)
        telemetry = read.telemetry.until(sol)
        return cls(workspace, config, read.entry, entries, telemetry, read.unread, read.left_out)

    def images_at(self, stops: Iterable[StopPrior]) -> tuple[ImageEntry, ...]:
        """The images taken at some stops."""
        names = {str(stop.stop) for stop in stops}
        return tuple(entry for entry in self.entries if entry.stop in names)


@dataclass(frozen=True, slots=True, eq=False)
class MapLabels:
    """The labels of all images on one map, and the telemetry of their stops."""

    entry: MissionEntry
    images: Sequence[tuple[ImageEntry, RoverImage]]
    telemetry: Telemetry
    unread: Mapping[str, str]
    """Unreadable images and vector files of the mission, with the reason."""
    left_out: Sequence[tuple[ImageEntry, str]]
    """Images with impossible labels, with the reason."""


_read: dict[tuple[Path, str], tuple[str, Mapping[str, MapLabels]]] = {}
"""The maps of a mission as last read, and their version, by store and mission."""


def read_map(name: str, workspace: Workspace) -> MapLabels:
    """The labels on a map of a mission, to which `assign_maps` has assigned them.

    Raises:
        ProductNotFoundError: there is no such map.
    """
    maps = read_maps(mission_of(name), workspace)
    if name not in maps:
        raise ProductNotFoundError(f"no image is on the map {name}; there are {', '.join(maps)}")
    return maps[name]


def read_maps(mission: str, workspace: Workspace) -> Mapping[str, MapLabels]:
    """All images of a mission, map by map, the one that is tied to the lander first.

    Every sol needs them, and reading thousands takes a while.
    """
    catalogue, key = workspace.catalogue, (workspace.store.root, mission)
    names = catalogue.maps_of(mission)
    version = repr([catalogue.images_version(name) for name in names])
    version += repr((catalogue.pointers(ProductKind.VECTORS), Settings().landing_sites))
    if (
        key not in _read
        or _read[key][0] != version
        or any(m.unread for m in _read[key][1].values())
    ):
        _read[key] = version, _read_maps(mission, names, workspace)
    return _read[key][1]


def assign_maps(mission: str, workspace: Workspace) -> list[str]:
    """Assign every image to the map of the sites connected with its own; returns their names.

    Annotations and edits of a removed map move to the map of their stops.
    """
    maps = read_maps(mission, workspace)
    moved = [
        replace(entry, mission=name)
        for name, one in maps.items()
        for entry in (*(e for e, _ in one.images), *(e for e, _ in one.left_out))
        if entry.mission != name
    ]
    if moved:
        _move_edits(mission, maps, workspace)
        workspace.catalogue.publish(images=moved)
    return list(maps)


def _move_edits(mission: str, maps: Mapping[str, MapLabels], workspace: Workspace) -> None:
    """Move annotations and edits of ties of removed maps; see `EditLog.move`."""
    for old in set(workspace.catalogue.maps_of(mission)) - maps.keys():
        site, *drive = origin_of(old) or (0,)
        origin = rover_frame(site, *drive) if drive else site_frame(site)
        for new, one in maps.items():
            with suppress(FrameError):  # not on this map
                from_site = one.telemetry.tree.pose(LSL, site_frame(site))
                place_m = one.telemetry.tree.pose(LSL, origin).translation_m
                moved = Pose(LSL, LSL, from_site.rotation, place_m)
                edits = EditLog.of(workspace.store.root)
                for edit in edits.move(old, new, partial(_carried, new_from_old=moved)):
                    event = {"mission": new, "edit": edit.id, "kind": str(edit.kind)}
                    workspace.catalogue.append_event(EDITS_CHANGED, event)
                break


def _carried(annotation: dict[str, Any], new_from_old: Pose) -> dict[str, Any]:
    """An annotation with its places (east, north and up, if known) on another map."""

    def carry(places: list[Any]) -> list[Any]:
        if isinstance(places[0], list):
            return [carry(inner) for inner in places]
        east, north, *up = places
        down = -up[0] if up else 0.0
        north, east, down = new_from_old.apply(np.array([[north, east, down]]))[0].tolist()
        return [east, north, *([-down] if up else [])]

    geometry = annotation["geometry"]
    return {**annotation, "geometry": {**geometry, "coordinates": carry(geometry["coordinates"])}}


def _read_maps(mission: str, names: Sequence[str], workspace: Workspace) -> dict[str, MapLabels]:
    unread: dict[str, str] = {}
    entries = [entry for name in names for entry in workspace.catalogue.images(name)]
    images = _read_labels(sorted(entries, key=lambda entry: entry.id), workspace, unread)
    files: list[VectorFile] = []
    for ref in workspace.catalogue.pointers(ProductKind.VECTORS):
        with keep_going(unread, ref.scope.name):
            files.append(read_vector_file(ref, workspace))
    files = [file for file in files if mission_id(file.mission) == mission]
    left_out = {entry.id: why for entry, why in _left_out(images)}
    labels = [label for entry, label in images if entry.id not in left_out]
    name_of, why_alone = _maps_of_stops(mission, labels, files)
    for entry, label in images:  # of a stop without a possible label
        name_of.setdefault(label.stop, entry.mission)
    read = {entry.id for entry, _ in images}
    unseen = {entry.mission for entry in entries if entry.id not in read}
    found: dict[str, MapLabels] = {}
    for name in sorted({*name_of.values(), *unseen}, key=origin_of):
        here = [(entry, label) for entry, label in images if name_of[label.stop] == name]
        kept = [(entry, label) for entry, label in here if entry.id not in left_out]
        site = landing_site(name, Settings().landing_sites)
        found[name] = MapLabels(
            MissionEntry(
                name, site.title, site.landing, why_alone.get(name, _note_of(name, site.landing))
            ),
            kept,
            read_telemetry([label for _, label in kept], files, origin_of(name)),
            unread,
            [(entry, left_out[entry.id]) for entry, _ in here if entry.id in left_out],
        )
    return found


def _maps_of_stops(
    mission: str, labels: Sequence[RoverImage], files: Sequence[VectorFile]
) -> tuple[dict[StopId, str], dict[str, str]]:
    """The map of every stop: that of its group of sites, or its own if its position is impossible.

    Also the reason for every map of a single stop.
    """
    origins = read_telemetry(labels, files).origins
    groups: dict[int, list[RoverImage]] = {}
    for label in labels:
        groups.setdefault(origins[label.stop.site], []).append(label)
    names: dict[StopId, str] = {}
    reasons: dict[str, str] = {}
    for origin, of_group in groups.items():
        name = untied_map(mission, origin) if origin else mission
        stops = read_telemetry(of_group, files, (origin,)).stops
        known = [TelemetryStop(one.stop, one.lsl_from_rover, one.sols) for one in stops]
        alone = implausible_stops(known)
        for one in stops:
            names[one.stop] = name
        for stop, reason in alone.items():
            names[stop] = untied_map(mission, stop.site, stop.drive)
            reasons[names[stop]] = (
                f"{stop} has a map of its own: {reason}; deliver correct labels or a site vector "
                "file"
            )
    return names, reasons


def _note_of(name: str, landing: LandingPoint) -> str | None:
    """Remedies for a map that is not tied to the lander."""
    if not origin_of(name):
        return None
    if not landing.is_on_mars:
        return (
            f"site {origin_of(name)[0]} is not tied to site 0; give poses of its stops in site 0 "
            "(reference_site in a poses CSV)"
        )
    return (
        f"site {origin_of(name)[0]} is not tied to the lander; deliver a site vector file (.svf), "
        "run `solmap run --places FILE` with poses, or add an orbital image by `solmap orbital add "
        f"IMAGE --mission {name}`, and its maps move to Mars"
    )


def _read_labels(
    entries: Sequence[ImageEntry], workspace: Workspace, unread: dict[str, str]
) -> list[tuple[ImageEntry, RoverImage]]:
    try:
        return list(zip(entries, image_records(entries, workspace), strict=True))
    except Exception:  # noqa: BLE001 - reading one by one shows which image
        labels = []
        for entry in entries:
            with keep_going(unread, entry.id):
                labels.append((entry, image_record(entry, workspace)))
        return labels


def _left_out(images: Sequence[tuple[ImageEntry, RoverImage]]) -> Iterator[tuple[ImageEntry, str]]:
    """Images with impossible labels, with the reason."""
    at_stops: dict[StopId, list[tuple[ImageEntry, RoverImage]]] = {}
    for entry, label in sorted(images, key=lambda both: (both[1].clock, both[0].id)):
        at_stops.setdefault(label.stop, []).append((entry, label))
    for of_stop in at_stops.values():
        reasons = implausible_poses([label.site_from_rover for _, label in of_stop])
        for (entry, _), why in zip(of_stop, reasons, strict=True):
            if why:
                yield (
                    entry,
                    f"{entry.id} is left out: {why}; deliver it with a corrected label",
                )


def _mode(config: PipelineConfig) -> AdjustmentMode:
    """How a single sol is adjusted; overall adjustments follow it."""
    mode = config.adjustment_mode
    return AdjustmentMode.SEQUENTIAL if mode is AdjustmentMode.OVERALL else mode


def _open_gate(
    config: PipelineConfig, previous: Standing | None, workspace: Workspace
) -> PipelineConfig:
    """Parameters with the gate of links as wide as the mission's errors of telemetry."""
    if previous is None:
        return config
    components = read_network(previous.network, workspace.store).adjusted.components
    shown = (Component.POSITION, Component.HEADING_STEP, Component.TILT)
    gate = config.cross_site.gate.opened(
        *(components.factors[COMPONENTS.index(kind)] for kind in shown)
    )
    return replace(config, cross_site=replace(config.cross_site, gate=gate))


def _window(
    touched: Sequence[StopPrior],
    stops: Sequence[StopPrior],
    known: _Known,
    previous: Standing | None,
) -> tuple[StopPrior, ...]:
    """The stops whose orientation new images at `touched` ones may change, and those linked."""
    first = min((stops.index(stop) for stop in touched), default=len(stops))
    recent = list(stops[max(0, first - WINDOW) :])
    if _mode(known.config) is AdjustmentMode.SEQUENTIAL:
        moving = _moving(previous, known.workspace)
        recent = [stop for stop in stops if stop in recent or moving is None or stop.stop in moving]
    window = {stop.stop for stop in recent}
    for stop in recent:
        window |= {old.stop for old in candidates(stop, stops, known.config)}
    return tuple(stop for stop in stops if stop.stop in window)


def _moving(previous: Standing | None, workspace: Workspace) -> tuple[StopId, ...] | None:
    """Stops that a sequential step moves; None, for all, after one that was not sequential."""
    network = read_network(previous.network, workspace.store).adjusted if previous else None
    return network.memory.window if network and network.memory else None


def candidates(
    stop: StopPrior, stops: Sequence[StopPrior], config: PipelineConfig
) -> list[StopPrior]:
    """The earlier stops with which a link is tried."""
    earlier = {old.stop: old for old in stops[: stops.index(stop)]}
    poses = {name: old.lsl_from_rover for name, old in earlier.items()}
    gate = config.cross_site.gate
    near = link_candidates(stop.lsl_from_rover, poses, config.links, gate)
    return [earlier[name] for name in near]
