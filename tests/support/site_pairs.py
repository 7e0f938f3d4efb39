"""Pairs of stops to be linked, and how links are held against the truth.

    python -m tests.support [--kind shared|foreign|husband] [--only crater] [--json FILE]

links every two stops of every simulated world that are at most 50 m apart, stops of different
worlds that telemetry claims to be 8 to 30 m apart (they share no ground: any link is false), and
the stops of `rendered_husband`, and prints a line for each and the totals.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.linking import (
    CrossSiteParams,
)
from solmap.photogrammetry.matching.cross_site.links import SiteLink
from solmap.photogrammetry.matching.inter_stereo import (
    InterStereoParams,
    point_pairs,
    tie_inter_stereo,
)
from solmap.photogrammetry.matching.records import MatchedStop
from tests.support.simulated_stops import SimulatedStop, WorldOfStops, simulated_stop

FARTHEST_M = 50.0
FALSE_BEYOND = (0.5, 0.02)
"""Metres, and share of the distance, by which a link may be wrong before it counts as false."""
NEAR, FAR = (9.0, 16.0), (14.0, 25.0)
TERRAINS = ("plains", "hills", "crater")
FIRST_SEED = 11


@dataclass(frozen=True, slots=True)
class SitePair:
    """Two stops to be linked: of one world, or of two and then without common ground."""

    earlier: tuple[WorldOfStops, int]
    later: tuple[WorldOfStops, int]
    claimed_m: tuple[float, float] | None = None
    """North and east of the later stop as a false telemetry claims it; None: its own telemetry."""

    @property
    def shares_ground(self) -> bool:
        """Whether both stops are in the same world."""
        return self.claimed_m is None

    @property
    def name(self) -> str:
        """Terrain, seed and number of both stops."""
        (one, k), (other, j) = self.earlier, self.later
        return (
            f"{one.terrain}{one.seed}:{k}-{other.terrain if one != other else ''}{other.seed}:{j}"
        )


def worlds_from(first_seed: int) -> tuple[WorldOfStops, ...]:
    """Six worlds with stops 9 to 50 m apart, numbered on from a seed.

    Every stop has a sun, a heading and telemetry errors of its own.
    """
    kinds = [(terrain, spacing) for spacing in (NEAR, FAR) for terrain in TERRAINS]
    return tuple(WorldOfStops(*kind, first_seed + k) for k, kind in enumerate(kinds))


WORLDS = worlds_from(FIRST_SEED)


def positive_pairs(worlds: Iterable[WorldOfStops] = WORLDS) -> list[SitePair]:
    """Every two stops of a world that are near enough to share ground."""
    found = []
    for which in worlds:
        places = [stop.lsl_from_rover.translation_m for stop in which.world().stops]
        for a, b in combinations(range(which.stops), 2):
            if np.hypot(*(places[b] - places[a])[:2]) <= FARTHEST_M:
                found.append(SitePair((which, a), (which, b)))
    return found


def negative_pairs(worlds: Iterable[WorldOfStops] = WORLDS) -> list[SitePair]:
    """Stops of different worlds, at claimed distances that spread evenly from 8 to 30 m."""
    names = [(which, k) for which in worlds for k in range(which.stops)]
    step = len(names) // 3 + 1
    pairs = []
    for k, one in enumerate(names):
        other = names[(k + step) % len(names)]
        distance_m, azimuth = 8.0 + 22.0 * (k + 0.5) / len(names), 2.4 * k  # the golden angle
        claimed_m = (distance_m * np.cos(azimuth), distance_m * np.sin(azimuth))
        if one[0] != other[0]:
            pairs.append(SitePair(one, other, (float(claimed_m[0]), float(claimed_m[1]))))
    return pairs


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of a pair, compared with the truth."""

    name: str
    shares_ground: bool
    distance_m: float
    """True, or claimed where no ground is shared."""
    telemetry_off_m: float
    linked: bool
    ties: int
    by_chance: int
    peak_z: float
    error_m: float
    """Of the position; NaN unless linked."""
    error_azimuth: float
    """Radians."""
    error_tilt: float
    stated_m: float
    """Standard deviation of the position as stated, all three axes together."""
    nees: float
    """Squared error in units of the stated covariance over its 6 freedoms: 1 if that is true."""
    sigma0: float
    seconds: float
    reason: str

    @property
    def is_false(self) -> bool:
        """A link without common ground, or at a wrong place."""
        limit_m = FALSE_BEYOND[0] + FALSE_BEYOND[1] * self.distance_m
        return self.linked and not (self.shares_ground and self.error_m <= limit_m)

    def __str__(self) -> str:
        return (
            f"{self.name:24s} {self.distance_m:5.1f} {self.telemetry_off_m:5.2f} "
            f"{'LINKED' if self.linked else '-':6s} {'FALSE' if self.is_false else '':5s} "
            f"{self.ties:4d} {self.by_chance:4d} {self.peak_z:5.1f} {self.error_m:6.3f} "
            f"{100 * self.error_m / self.distance_m:5.2f} {np.rad2deg(self.error_azimuth):6.2f} "
            f"{np.rad2deg(self.error_tilt):5.2f} {self.stated_m:6.3f} {self.nees:6.1f} "
            f"{self.sigma0:5.2f} {self.seconds:5.1f}  {self.reason}"
        )


HEADING = (
    "pair                     dist  telem  state       ties chance   z    err_m   %    az_deg tilt"
    "  stated   nees sigma0  s    reason"
)


def stops_of(pair: SitePair) -> tuple[SimulatedStop, SimulatedStop]:
    """Both stops, as matched."""
    return _stop(*pair.earlier), _stop(*pair.later)


@lru_cache(maxsize=3)
def _stop(which: WorldOfStops, number: int) -> SimulatedStop:
    return pointed(simulated_stop(which, number))


def pointed(stop: SimulatedStop) -> SimulatedStop:
    """A stop with its pairs pointed by its inter-stereo ties, as `tasks.network.tie` links it."""
    ties = tie_inter_stereo(stop.matched, InterStereoParams()).ties
    alignment = CrossSiteParams().trials.alignment
    return replace(stop, matched=point_pairs(stop.matched, ties, alignment))


def matched_stops(
    pair: SitePair, one: SimulatedStop, other: SimulatedStop
) -> tuple[MatchedStop, MatchedStop]:
    """Both stops as telemetry places them; false telemetry keeps the attitude."""
    if pair.claimed_m is None:
        return one.matched, other.matched
    reported = other.matched.lsl_from_rover
    place = one.matched.lsl_from_rover.translation_m + np.array([*pair.claimed_m, 0.0])
    return one.matched, other.reported_at(
        Pose(reported.target, reported.source, reported.rotation, place)
    )


def evaluated(
    pair: SitePair, one: SimulatedStop, other: SimulatedStop, link: SiteLink, seconds: float
) -> Outcome:
    """A link held against the truth."""
    true = one.true.inverse @ other.true
    reported = one.matched.lsl_from_rover.inverse @ other.matched.lsl_from_rover
    found, nan = link.earlier_from_later, float("nan")
    shift = true.translation_m - found.translation_m
    level = one.true.rotation @ true.rotation @ found.rotation.T @ one.true.rotation.T
    turn = Rotation.from_matrix(level).as_rotvec()
    known = link.linked and pair.shares_ground
    in_axes = Rotation.from_matrix(true.rotation @ found.rotation.T).as_rotvec()
    error = np.concatenate([in_axes, shift])
    distance_m = float(np.hypot(*(one.true.rotation @ true.translation_m)[:2]))
    if not pair.shares_ground:
        distance_m = link.figures.distance_m
    return Outcome(
        pair.name,
        pair.shares_ground,
        distance_m,
        float(np.linalg.norm(reported.translation_m - true.translation_m))
        if pair.shares_ground
        else nan,
        link.linked,
        link.figures.ties,
        link.figures.by_chance,
        link.figures.peak_z,
        float(np.linalg.norm(shift)) if known else nan,
        float(abs(turn[2])) if known else nan,
        float(np.hypot(*turn[:2])) if known else nan,
        float(np.sqrt(np.trace(link.covariance[3:, 3:]))) if link.linked else nan,
        float(error @ np.linalg.solve(link.covariance, error)) / 6 if known else nan,
        link.figures.sigma0,
        seconds,
        link.reason,
    )


class Views:
    """Stops made ready for linking, the last few kept."""

    def __init__(self, params: CrossSiteParams, kept: int = 3) -> None:
        self.params, self.kept = params, kept
        self._made: dict[StopId, StopViews] = {}

    def of(self, stop: MatchedStop) -> StopViews:
        """A stop's views, at the place that telemetry now claims: they depend on attitude alone."""
        if stop.stop not in self._made:
            while len(self._made) >= self.kept:
                self._made.pop(next(iter(self._made)))
            self._made[stop.stop] = StopViews.of(stop, self.params.birds_eye)
        return replace(self._made[stop.stop], stop=stop)


def totals(outcomes: Iterable[Outcome]) -> Iterator[str]:
    """Link rates by distance, false links, and errors."""
    every = list(outcomes)
    shared = [o for o in every if o.shares_ground]
    for low, high in ((0, 15), (15, 25), (25, 35), (35, 50)):
        some = [o for o in shared if low < o.distance_m <= high]
        good = [o for o in some if o.linked and not o.is_false]
        if some:
            yield f"{low}-{high} m: {len(good)} of {len(some)} linked" + _errors(good)
    without = [o for o in every if not o.shares_ground]
    yield (
        f"false links: {sum(o.is_false for o in shared)} of {len(shared)} with common ground, "
        f"{sum(o.is_false for o in without)} of {len(without)} without"
    )
    good = [o for o in shared if o.linked and not o.is_false]
    if good:
        yield (
            f"NEES / 6 mean {np.mean([o.nees for o in good]):.2f} median "
            f"{np.median([o.nees for o in good]):.2f}; sigma0 median "
            f"{np.median([o.sigma0 for o in good]):.2f}; "
            f"seconds a pair {np.mean([o.seconds for o in every]):.1f}"
        )


def _errors(good: list[Outcome]) -> str:
    if not good:
        return ""
    share = [100 * o.error_m / o.distance_m for o in good]
    errors = [o.error_m for o in good]
    return (
        f", position error median {np.median(errors):.3f} m ({np.median(share):.2f} %), "
        f"largest {max(errors):.3f} m"
    )
