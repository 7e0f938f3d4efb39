"""Where telemetry says the rover stood: labels and vector files, chained into the LSL."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from solmap.photogrammetry.adjustment.model.network import StopPrior
from solmap.photogrammetry.archive.tables.vector_files import (
    VectorFile,
    best_poses,
    lsl_tree,
    parse_vector_file,
)
from solmap.photogrammetry.errors import FrameError
from solmap.photogrammetry.frames import LSL, FrameTree, Pose, site_frame
from solmap.photogrammetry.imagery import RoverImage, StopId
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """All stops of a mission in the order of the traverse, and the frames they hang in."""

    stops: tuple[StopPrior, ...]
    first_clocks: Mapping[StopId, float]
    """Spacecraft clock of the first image of each of them, seconds."""
    tree: FrameTree
    note: str | None
    """Says so when the LSL is not the lander's."""
    unplaced: tuple[StopId, ...]
    """Stops at sites that no chain joins to the LSL."""

    def stop(self, stop: StopId) -> StopPrior:
        """The telemetry of one stop.

        Raises:
            FrameError: the stop is not placed.
        """
        for known in self.stops:
            if known.stop == stop:
                return known
        raise FrameError(why_unplaced(stop))


def why_unplaced(stop: StopId) -> str:
    """One line for a stop that cannot be put on the map."""
    return (
        f"{stop} is not on the map: no chain of sites joins site {stop.site} to the LSL; "
        "deliver the site vector file (.svf) that does"
    )


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
    chain = [pose for pose in best_poses(vector_files) if pose.source.kind != rovers[0].source.kind]
    sites = {stop.site for stop in by_stop}
    declared = _declared_sites(images, chain, sites)
    lsl = lsl_tree([*declared, *chain, *rovers], sites=sites)
    placed, unplaced = [], []
    for stop, taken in by_stop.items():
        try:
            lsl_from_rover = lsl.tree.pose(LSL, stop.frame)
        except FrameError:
            unplaced.append(stop)
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
    return Telemetry(tuple(placed), clocks, lsl.tree, lsl.note, tuple(sorted(unplaced)))


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
    files = []
    for ref in workspace.catalogue.pointers(ProductKind.VECTORS):
        text = workspace.store.path(ref).read_text(errors="replace")
        parsed = parse_vector_file(text, ref.scope.name)
        if parsed.mission.upper() == mission:
            files.append(parsed)
    return files
