"""A stop made ready for being tied to another one: seen from above, and pair by pair."""

from __future__ import annotations

from dataclasses import dataclass

from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.birds_eye import BirdsEyeParams, BirdsEyeView, birds_eye_views
from solmap.photogrammetry.matching.conjugates import TieView
from solmap.photogrammetry.matching.ground_patches import GroundView
from solmap.photogrammetry.matching.ground_surface import GroundSurface
from solmap.photogrammetry.matching.records import MatchedStop


@dataclass(frozen=True, slots=True, eq=False)
class StopViews:
    """A stop made ready for linking; worth keeping when it is linked more than once."""

    stop: MatchedStop
    birds_eye: BirdsEyeView
    views: tuple[GroundView, ...]

    @classmethod
    def of(cls, stop: MatchedStop, params: BirdsEyeParams) -> StopViews:
        """Draw the stop from above, coarsely to search in and finely as the ground of its pairs."""
        seen, fine = birds_eye_views(stop, params, (params.cell_m, params.surface_cell_m))
        surface = GroundSurface.of(fine)
        level = stop.lsl_from_rover.rotation
        views = tuple(GroundView.of(TieView.of(pair), surface, level) for pair in stop.pairs)
        return cls(stop, seen, views)

    @property
    def id(self) -> StopId:
        """Which stop it is."""
        return self.stop.stop

    @property
    def pair_ids(self) -> tuple[str, ...]:
        """Its pairs, in the order of `views`."""
        return tuple(view.view.pair.pair_id for view in self.views)
