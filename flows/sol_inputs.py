"""What is known when a sol, or a whole mission, is processed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from solmap.config.landing import landing_site
from solmap.config.pipeline import PipelineConfig, load_pipeline
from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.flows.runtime.failures import keep_going
from solmap.photogrammetry.adjustment.model.network import StopPrior
from solmap.photogrammetry.adjustment.model.variance_components import COMPONENTS, Component
from solmap.photogrammetry.adjustment.modes.mission import AdjustmentMode
from solmap.photogrammetry.archive.tables.vector_files import VectorFile
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import RoverImage, StopId
from solmap.photogrammetry.matching.cross_site.gate import link_candidates
from solmap.photogrammetry.traverse.plausibility import (
    TelemetryStop,
    implausible_stops,
    strays,
)
from solmap.products.catalogue.catalogue import ImageEntry, MissionEntry
from solmap.products.catalogue.images import image_record, image_records
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductKind
from solmap.tasks.images.telemetry import Telemetry, read_telemetry, read_vector_file
from solmap.tasks.network.orientations import Standing

WINDOW = 3
"""Earlier stops that a sol may change: as far back as `adjust_stepwise` reaches."""


@dataclass(frozen=True, slots=True, eq=False)
class SolInputs:
    """What is known when a sol is processed, or all sols up to one together."""

    workspace: Workspace
    config: PipelineConfig
    mission: MissionEntry
    sol: int
    mode: AdjustmentMode
    telemetry: Telemetry
    new_stops: tuple[StopId, ...]
    """Stops first seen this sol."""
    touched: tuple[StopId, ...]
    """Stops that images of this sol were taken at."""
    unplaced: tuple[str, ...]
    """Why stops and images of this sol cannot be put on the map, a line each."""
    unread: Mapping[str, str]
    """What could not be read, images and files, and why."""
    unpaired: tuple[ImageEntry, ...]
    """Images of this sol that have no stereo partner."""
    window: tuple[StopPrior, ...]
    """Stops whose orientation this sol may change, and those linked to them."""
    images: tuple[ImageEntry, ...]
    """Those taken at the stops of the window, up to this sol."""

    @property
    def landing(self) -> LandingPoint:
        """Where the map is tied to Mars."""
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
        known.config,
        known.mission,
        sol,
        _mode(known.config),
        known.telemetry,
        tuple(stop.stop for stop in touched if stop.sols[0] == sol),
        tuple(stop.stop for stop in touched),
        (
            *(why for stop, why in known.telemetry.unplaced.items() if str(stop) in seen),
            *(_why_stray(entry) for entry in known.strays if entry.sol == sol),
        ),
        known.unread,
        tuple(entry for entry in entries if entry.sol == sol and entry.partner is None),
        window,
        known.images_at(window),
    )


def gather_all(
    mission: str, sol: int, store: Path, pipeline: str, previous: Standing | None = None
) -> SolInputs:
    """The same for the overall adjustment of all stops up to a sol."""
    known = _Known.of(mission, sol, store, pipeline, previous)
    stops = known.telemetry.stops
    return SolInputs(
        known.workspace,
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
    """What the store and the settings say of a mission up to a sol."""

    workspace: Workspace
    config: PipelineConfig
    mission: MissionEntry
    entries: tuple[ImageEntry, ...]
    telemetry: Telemetry
    unread: Mapping[str, str]
    strays: Sequence[ImageEntry]

    @classmethod
    def of(
        cls, mission: str, sol: int, store: Path, pipeline: str, previous: Standing | None
    ) -> _Known:
        workspace = open_workspace(store)
        site = landing_site(mission, Settings().landing_sites)
        read = read_mission(mission, workspace)
        telemetry = read.telemetry(sol)
        entries = tuple(entry for entry, _ in read.images if entry.sol <= sol)
        entry = MissionEntry(mission, site.title, site.landing, telemetry.note)
        config = _open_gate(load_pipeline(pipeline), previous, workspace)
        return cls(workspace, config, entry, entries, telemetry, read.unread, read.strays)

    def images_at(self, stops: Iterable[StopPrior]) -> tuple[ImageEntry, ...]:
        """The images taken at some stops."""
        names = {str(stop.stop) for stop in stops}
        return tuple(entry for entry in self.entries if entry.stop in names)


@dataclass(frozen=True, slots=True, eq=False)
class MissionLabels:
    """The labels of all images of a mission and its vector files, as far as they can be read."""

    images: Sequence[tuple[ImageEntry, RoverImage]]
    vector_files: Sequence[VectorFile]
    unread: Mapping[str, str]
    """Images and files that cannot be read, and why."""
    set_aside: Mapping[StopId, str]
    """Stops whose telemetry is implausible, and why; judged by all that is known of the mission."""
    strays: Sequence[ImageEntry] = ()
    """Images that are left out, for most images of their stop place the rover elsewhere."""

    @classmethod
    def read(cls, mission: str, workspace: Workspace) -> MissionLabels:
        """Read what there is in the store."""
        unread: dict[str, str] = {}
        images = _read_labels(workspace.catalogue.images(mission), workspace, unread)
        vectors: list[VectorFile] = []
        for ref in workspace.catalogue.pointers(ProductKind.VECTORS):
            with keep_going(unread, ref.scope.name):
                vectors.append(read_vector_file(ref, workspace))
        of_mission = [file for file in vectors if file.mission.upper() == mission]
        left_out = _strays(images)
        names = {entry.id for entry in left_out}
        kept = [(entry, label) for entry, label in images if entry.id not in names]
        implausible = _implausible([label for _, label in kept], of_mission)
        return cls(kept, of_mission, unread, implausible, left_out)

    def telemetry(self, sol: int | None = None) -> Telemetry:
        """Where telemetry has the rover up to a sol, without the stops that are set aside."""
        labels = [label for entry, label in self.images if sol is None or entry.sol <= sol]
        telemetry = read_telemetry(labels, self.vector_files)
        known = telemetry.first_clocks
        return telemetry.without({s: why for s, why in self.set_aside.items() if s in known})


_read: dict[tuple[Path, str], tuple[str, MissionLabels]] = {}
"""What was read of a mission last, and its version, by store and mission."""


def read_mission(mission: str, workspace: Workspace) -> MissionLabels:
    """The labels of a mission; sol after sol asks for them, and reading thousands takes a while."""
    catalogue = workspace.catalogue
    vectors = catalogue.pointers(ProductKind.VECTORS)
    name, version = (workspace.store.root, mission), catalogue.images_version(mission)
    version += repr(vectors)
    if name not in _read or _read[name][0] != version or _read[name][1].unread:
        _read[name] = version, MissionLabels.read(mission, workspace)
    return _read[name][1]


def _read_labels(
    entries: Sequence[ImageEntry], workspace: Workspace, unread: dict[str, str]
) -> list[tuple[ImageEntry, RoverImage]]:
    try:
        return list(zip(entries, image_records(entries, workspace), strict=True))
    except Exception:  # noqa: BLE001 - of one image: one by one shows of which
        labels = []
        for entry in entries:
            with keep_going(unread, entry.id):
                labels.append((entry, image_record(entry, workspace)))
        return labels


def _strays(images: Sequence[tuple[ImageEntry, RoverImage]]) -> list[ImageEntry]:
    at_stops: dict[StopId, list[tuple[ImageEntry, RoverImage]]] = {}
    for entry, label in images:
        at_stops.setdefault(label.stop, []).append((entry, label))
    return [
        entry
        for of_stop in at_stops.values()
        for (entry, _), is_stray in zip(
            of_stop, strays([label.site_from_rover for _, label in of_stop]), strict=True
        )
        if is_stray
    ]


def _why_stray(entry: ImageEntry) -> str:
    return (
        f"{entry.id} is left out: it places the rover elsewhere than most images of {entry.stop} "
        "do; deliver it with a label that is mended"
    )


def _implausible(labels: Sequence[RoverImage], files: Sequence[VectorFile]) -> dict[StopId, str]:
    poses: dict[StopId, list[Pose]] = {}
    for label in labels:
        poses.setdefault(label.stop, []).append(label.site_from_rover)
    return implausible_stops(
        [
            TelemetryStop(one.stop, one.lsl_from_rover, one.sols, tuple(poses[one.stop]))
            for one in read_telemetry(labels, files).stops
        ]
    )


def _mode(config: PipelineConfig) -> AdjustmentMode:
    """How a single sol is adjusted; overall adjustments follow it."""
    mode = config.adjustment_mode
    return AdjustmentMode.SEQUENTIAL if mode is AdjustmentMode.OVERALL else mode


def _open_gate(
    config: PipelineConfig, previous: Standing | None, workspace: Workspace
) -> PipelineConfig:
    """With the gate of links as wide as the mission has shown telemetry to be off."""
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
    """The earlier stops that one is tried to be linked with."""
    earlier = {old.stop: old for old in stops[: stops.index(stop)]}
    poses = {name: old.lsl_from_rover for name, old in earlier.items()}
    gate = config.cross_site.gate
    near = link_candidates(stop.lsl_from_rover, poses, config.links, gate)
    return [earlier[name] for name in near]
