"""Where telemetry says the rover stood: labels and vector files, chained into the LSL."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from solmap.photogrammetry.adjustment.model.network import StopPrior
from solmap.photogrammetry.archive.tables.vector_files import (
    VectorFile,
    best_poses,
    lsl_tree,
    parse_vector_file,
)
from solmap.photogrammetry.errors import FrameError, VectorFileError
from solmap.photogrammetry.frames import LSL, FrameKind, FrameTree, Pose, site_frame
from solmap.photogrammetry.imagery import RoverImage, StopId
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """All stops of a mission in the order of the traverse, and the frames they hang in."""

    stops: tuple[StopPrior, ...]
    first_clocks: Mapping[StopId, float]
    """Spacecraft clock of the first image of each of them, seconds."""
    tree: FrameTree
    note: str | None
    """Says so when the LSL is not the lander's."""
    unplaced: Mapping[StopId, str]
    """Stops that cannot be put on the map, and why: no chain joins their sites to the LSL."""

    def stop(self, stop: StopId) -> StopPrior:
        """The telemetry of one stop.

        Raises:
            FrameError: the stop is not placed.
        """
        for known in self.stops:
            if known.stop == stop:
                return known
        raise FrameError(self.unplaced.get(stop, f"{stop} is not known"))

    def without(self, stops: Mapping[StopId, str]) -> Telemetry:
        """The same with some stops set aside, by name and reason."""
        return replace(
            self,
            stops=tuple(known for known in self.stops if known.stop not in stops),
            first_clocks={k: at for k, at in self.first_clocks.items() if k not in stops},
            unplaced={
                **self.unplaced,
                **{stop: _why_aside(stop, reason) for stop, reason in stops.items()},
            },
        )


def _why_unplaced(stop: StopId) -> str:
    return (
        f"{stop} is not on the map: no chain of sites joins site {stop.site} to the LSL; "
        "deliver the site vector file (.svf) that does"
    )


def _why_aside(stop: StopId, reason: str) -> str:
    return f"{stop} is not on the map: {reason}; deliver labels or a site vector file that mend it"


def read_telemetry(images: Sequence[RoverImage], vector_files: Sequence[VectorFile]) -> Telemetry:
    """Chain the labels' rover poses through the site vector files into the LSL.

    The rover's pose in its site comes from the label of the first image of the stop; chains between
    sites come from the vector files and, for sites they leave out, from labels that say where their
    site lies in another one of the traverse (those of MER do not).
    """
    by_stop: dict[StopId, list[RoverImage]] = defaultdict(list)
    for image in sorted(images, key=lambda image: image.clock):
        by_stop[image.stop].append(image)
    rovers = [taken[0].site_from_rover for taken in by_stop.values()]
    chain = [pose for pose in best_poses(vector_files) if pose.source.kind is not FrameKind.ROVER]
    sites = {stop.site for stop in by_stop}
    declared = _declared_sites(images, chain, sites)
    lsl = lsl_tree([*declared, *chain, *rovers], sites=sites)
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
    unplaced = {stop: _why_unplaced(stop) for stop in sorted(loose)}
    return Telemetry(tuple(placed), clocks, lsl.tree, lsl.note, unplaced)


def _declared_sites(
    images: Sequence[RoverImage], chain: Sequence[Pose], sites: set[int]
) -> list[Pose]:
    """Sites placed by labels in another site that is known, where no vector file places them."""
    placed = {pose.source for pose in chain}
    known = {site_frame(site) for site in sites} | placed | {pose.target for pose in chain}
    by_site = {
        image.parent_from_site.source: image.parent_from_site
        for image in sorted(images, key=lambda image: image.clock, reverse=True)
        if image.parent_from_site is not None
    }
    return [pose for site, pose in by_site.items() if site not in placed and pose.target in known]


def vector_files(mission: str, workspace: Workspace) -> list[VectorFile]:
    """The vector files of a mission that were delivered, the latest of each name."""
    files: list[VectorFile] = []
    for ref in workspace.catalogue.pointers(ProductKind.VECTORS):
        try:
            files.append(read_vector_file(ref, workspace))
        except VectorFileError as error:  # an earlier version took it
            log.warning("%s is left out: %s", ref.scope, error)
    return [file for file in files if file.mission.upper() == mission]


def read_vector_file(ref: ProductRef, workspace: Workspace) -> VectorFile:
    """A vector file that was delivered."""
    text = workspace.store.path(ref).read_text(errors="replace")
    return parse_vector_file(text, ref.scope.name)
