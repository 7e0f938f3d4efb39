"""Poses of stops by telemetry: labels and vector files, chained to the LSL."""

from __future__ import annotations

import logging
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from solmap.photogrammetry.adjustment.model.network import ControlFrame, StopControl, StopPrior
from solmap.photogrammetry.archive.missions import mission_id
from solmap.photogrammetry.archive.tables.places import LOCALISED, SPICE
from solmap.photogrammetry.archive.tables.vector_files import (
    LslTree,
    Solution,
    VectorFile,
    lsl_tree,
    parse_vector_file,
    ranked,
)
from solmap.photogrammetry.errors import FrameError, VectorFileError
from solmap.photogrammetry.frames import (
    LSL,
    Frame,
    FrameKind,
    FrameTree,
    Pose,
    rover_frame,
    site_frame,
)
from solmap.photogrammetry.imagery import RoverImage, StopId
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef, mission_of

log = logging.getLogger(__name__)

LOCALISED_SIGMA_M = 5.0
"""Standard deviation of a position in an orbital image with cells of 0.25 m, whose georeference has
an error of some metres."""
STATED = (LOCALISED, SPICE)
"""Solutions other than the labels' telemetry; `LOCALISED_SIGMA_M` is used where they have no
standard deviation."""
STATED_SHIFT_M, STATED_TURN_DEG = 300.0, 3.0
"""Common error of the poses of one source: relative to the position of the map's first stop."""
StatedPoses: TypeAlias = tuple[ControlFrame, tuple[StopControl, ...]]
"""The poses of stops by one source, as observations of the network in a separate frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """All stops of a mission in the order of the traverse, with their frames."""

    stops: tuple[StopPrior, ...]
    first_clocks: Mapping[StopId, float]
    """Spacecraft clock of the first image of each of them, seconds."""
    tree: FrameTree
    origins: Mapping[int, int]
    """The lowest site of its group, by site: 0 for all that are tied to the lander."""
    unplaced: Mapping[StopId, str]
    """Stops that are not on this map, with the reason: no chain joins their sites to the LSL."""
    sigma_m: Mapping[tuple[Frame, Frame], float] = field(default_factory=dict)
    """Standard deviations of sites and stops located by other means than wheels, by both frames."""
    stated: tuple[StatedPoses, ...] = ()
    """Poses of stops by other sources than their labels, source by source."""

    def stop(self, stop: StopId) -> StopPrior:
        """The telemetry of one stop.

        Raises:
            FrameError: the stop has no pose.
        """
        for known in self.stops:
            if known.stop == stop:
                return known
        raise FrameError(self.unplaced.get(stop, f"{stop} is not known"))

    def sigma_from_origin_m(self, stop: StopId, slip: float) -> float:
        """Standard deviation of a stop's position relative to the LSL's origin, by telemetry.

        Slip is systematic, so the error grows with the distance along the chain of sites, by `slip`
        of it.
        """
        driven_m, found_m, here = 0.0, 0.0, stop.frame
        while here in self.tree.parent_from:
            step = self.tree.parent_from[here]
            sigma_m = self.sigma_m.get((here, step.target))
            if sigma_m is None:
                driven_m += float(np.linalg.norm(step.translation_m))
            else:
                found_m = math.hypot(found_m, sigma_m)
            here = step.target
        return math.hypot(slip * driven_m, found_m)

    def until(self, sol: int) -> Telemetry:
        """The telemetry without the stops and sols after one."""
        stops = tuple(
            replace(known, sols=tuple(day for day in known.sols if day <= sol))
            for known in self.stops
            if known.sols[0] <= sol
        )
        clocks = {known.stop: self.first_clocks[known.stop] for known in stops}
        return replace(self, stops=stops, first_clocks=clocks)


def read_telemetry(
    images: Sequence[RoverImage], vector_files: Sequence[VectorFile], origin: tuple[int, ...] = ()
) -> Telemetry:
    """Chain the labels' rover poses through the vector files to the LSL of one group of sites.

    The rover's pose in its site comes from the label of the first image of the stop; chains between
    sites come from the vector files and, for sites missing there, from labels that give the
    position of their site in another one of the traverse (those of MER do not). Where vector files
    give the rover in another site (a PLACES table in site 0), this connects its site if nothing
    else does.

    Args:
        images: Of one mission.
        vector_files: Of the same.
        origin: (site,) whose frame the LSL is, as `origin_of` a map gives it; the lander's, or
            that of the lowest site, by default. (site, drive): the LSL is level at that stop.
    """
    by_stop: dict[StopId, list[RoverImage]] = defaultdict(list)
    for image in sorted(images, key=lambda image: (image.clock, image.id)):
        by_stop[image.stop].append(image)
    stated = ranked(vector_files)
    lsl = _tree(by_stop, stated, origin)
    placed, loose = [], []
    for stop, taken in by_stop.items():
        try:
            lsl_from_rover = lsl.tree.pose(LSL, stop.frame)
        except FrameError:
            loose.append(stop)
            continue
        placed.append(
            StopPrior(
                stop,
                lsl_from_rover,
                taken[0].attitude_measured_by,
                tuple(sorted({image.sol for image in taken})),
            )
        )
    placed.sort(key=lambda known: (known.stop.site, known.stop.drive))
    clocks = {known.stop: by_stop[known.stop][0].clock for known in placed}
    unplaced = {
        stop: f"{stop} is not on this map: no chain of sites joins site {stop.site} to its origin"
        for stop in sorted(loose)
    }
    sigma_m = {
        (one.frame, site_frame(one.reference_site)): _sigma_m(one)
        for one in reversed(stated)
        if _is_stated(one) and (one.kind is FrameKind.SITE or one.reference_site != one.counter[0])
    }
    others = tuple(stated_poses(vector_files, [known.stop for known in placed], lsl.tree))
    return Telemetry(tuple(placed), clocks, lsl.tree, lsl.origins, unplaced, sigma_m, others)


def _is_stated(one: Solution) -> bool:
    return one.solution_id in STATED or one.sigma_m is not None


def _sigma_m(one: Solution) -> float:
    return LOCALISED_SIGMA_M if one.sigma_m is None else one.sigma_m


def stated_poses(
    files: Sequence[VectorFile], stops: Sequence[StopId], tree: FrameTree
) -> Iterator[StatedPoses]:
    """Poses of stops on the map from each file, by other means than telemetry."""
    by_frame = {stop.frame: stop for stop in stops}
    for file in sorted(files, key=lambda file: file.source):
        control: dict[StopId, StopControl] = {}
        for one in sorted(file.solutions, key=lambda one: one.counter):
            if one.frame not in by_frame or not _is_stated(one):
                continue
            try:
                pose = tree.pose(LSL, site_frame(one.reference_site)) @ one.pose
            except FrameError:  # that site is not on this map
                continue
            stop = by_frame[one.frame]
            control[stop] = _control(stop, pose, one, file.source)
        if control:
            places = [(one.east_m, one.north_m) for one in control.values()]
            east_m, north_m = np.mean(places, axis=0).tolist()
            frame = ControlFrame.from_sigmas(
                file.source,
                (east_m, north_m),
                shift_m=STATED_SHIFT_M,
                rotation_deg=STATED_TURN_DEG,
                scale=0.0,
            )
            yield frame, tuple(control.values())


def _control(stop: StopId, pose: Pose, one: Solution, source: str) -> StopControl:
    north_m, east_m, down_m = pose.translation_m.tolist()
    variances, azimuth_deg = [_sigma_m(one) ** 2] * 3, None
    if one.sigma_deg is not None:
        variances.append(math.radians(one.sigma_deg) ** 2)
        azimuth_deg = math.degrees(math.atan2(pose.rotation[1, 0], pose.rotation[0, 0]))
    return StopControl(stop, source, east_m, north_m, np.diag(variances), -down_m, azimuth_deg)


def _tree(
    by_stop: Mapping[StopId, Sequence[RoverImage]],
    stated: Sequence[Solution],
    origin: tuple[int, ...],
) -> LslTree:
    rovers = [taken[0].site_from_rover for taken in by_stop.values()]
    sites = {stop.site for stop in by_stop}
    if len(origin) > 1:
        site, rover = site_frame(origin[0]), rover_frame(*origin)
        of_stop = [pose for pose in rovers if pose.source == rover]
        level = Pose(LSL, site, np.eye(3), -of_stop[0].translation_m)
        return LslTree(FrameTree().with_poses([*of_stop, level]), origin[0], {})
    known = {pose.source for pose in rovers}
    of_sites = [one.pose for one in stated if one.kind is FrameKind.SITE]
    elsewhere = [
        one.pose for one in stated if one.frame in known and one.reference_site != one.counter[0]
    ]
    chain = {pose.source: pose for pose in reversed(of_sites)}.values()
    images = [image for taken in by_stop.values() for image in taken]
    declared = _declared_sites(images, [*chain], sites)
    given = [*chain, *declared, *rovers, *of_sites, *elsewhere]
    return lsl_tree(given, sites, *origin)


def _declared_sites(
    images: Sequence[RoverImage], chain: Sequence[Pose], sites: set[int]
) -> list[Pose]:
    """Sites located by labels in another known site, where no vector file locates them."""
    placed = {pose.source for pose in chain}
    known = {site_frame(site) for site in {0, *sites}} | placed | {pose.target for pose in chain}
    by_site = {
        image.parent_from_site.source: image.parent_from_site
        for image in sorted(images, key=lambda image: image.clock, reverse=True)
        if image.parent_from_site is not None
    }
    return [pose for site, pose in by_site.items() if site not in placed and pose.target in known]


def vector_files(mission: str, workspace: Workspace) -> list[VectorFile]:
    """The delivered vector files of a mission."""
    files: list[VectorFile] = []
    for ref in workspace.catalogue.pointers(ProductKind.VECTORS):
        try:
            files.append(read_vector_file(ref, workspace))
        except VectorFileError as error:  # stored by an earlier version
            log.warning("%s is left out: %s", ref.scope, error)
    return [file for file in files if mission_id(file.mission) == mission_of(mission)]


def read_vector_file(ref: ProductRef, workspace: Workspace) -> VectorFile:
    """A delivered vector file."""
    text = workspace.store.path(ref).read_text(errors="replace")
    return parse_vector_file(text, ref.scope.name)
