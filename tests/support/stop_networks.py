"""Networks of stops put together in memory, adjusted as a whole, and held against the truth.

    python -m tests.support.stop_networks husband plains61 .cache/worlds/opposite

ties every stop and every two that follow each other, adjusts them together and prints for each stop
its error, what is stated, and the squared error in units of the stated covariance over its 6
freedoms. The number after a terrain is the seed of its world; `NEAR` to seed 63, `FAR` beyond.
`realistic-hills7` is the world of `solmap simulate --stops 3 --seed 7 --realistic`.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedStop,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.network import Network, PairGeometry, StopPrior
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.linking import (
    CrossSiteParams,
    tie_cross_site,
)
from solmap.photogrammetry.matching.cross_site.surface_matching import SurfaceTieParams
from solmap.photogrammetry.matching.inter_stereo import (
    InterStereoParams,
    point_pairs,
    tie_inter_stereo,
)
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.matching.tracks import TrackParams, build_tie_points
from solmap.photogrammetry.synthetic.scene import WorldParams, realistic_params
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from tests.support.rendered_stops import rendered_stops
from tests.support.simulated_stops import ROOT, SimulatedStop, WorldOfStops, simulated_stop
from tests.support.site_pairs import FAR, NEAR, TERRAINS

STOPS = 3
REALISTIC = "realistic-"
LAST_NEAR = 63


@dataclass(frozen=True, slots=True)
class StopError:
    """An adjusted stop held against the truth."""

    driven_m: float
    error_m: float
    azimuth_deg: float
    tilt_deg: float
    stated_m: float
    """Standard deviation of the position, all three axes together."""
    nees: float
    """Squared error in units of the stated covariance over its 6 freedoms."""

    @classmethod
    def of(cls, adjusted: AdjustedStop, true: SimulatedStop, driven_m: float) -> "StopError":
        """The errors of a stop that far along the traverse."""
        pose = adjusted.lsl_from_rover
        turn = Rotation.from_matrix(true.true.rotation @ pose.rotation.T).as_rotvec()
        error = np.concatenate([turn, true.true.translation_m - pose.translation_m])
        azimuth, tilt = np.degrees([abs(turn[2]), np.hypot(*turn[:2])])
        return cls(
            driven_m,
            float(np.linalg.norm(error[3:])),
            float(azimuth),
            float(tilt),
            float(np.linalg.norm(adjusted.sigma_ned_m)),
            float(error @ np.linalg.solve(adjusted.covariance, error)) / 6,
        )

    def __str__(self) -> str:
        return (
            f"  {self.driven_m:5.1f} m: {100 * self.error_m:5.1f} cm, "
            f"{100 * self.error_m / self.driven_m:.2f} %, azimuth {self.azimuth_deg:.2f}, "
            f"tilt {self.tilt_deg:.2f} deg; stated {100 * self.stated_m:.1f} cm, "
            f"NEES / 6 {self.nees:.2f}"
        )


def network_of(stops: Sequence[SimulatedStop], *, surface_matching: bool = True) -> Network:
    """Stops in the order of their traverse, each tied within and with the next.

    The first stands where it truly stood.
    """
    ties: list[Ties] = [tie_inter_stereo(s.matched, InterStereoParams()).ties for s in stops]
    params = CrossSiteParams(surface_matching=SurfaceTieParams(enabled=surface_matching))
    alignment = params.trials.alignment
    views = [
        StopViews.of(point_pairs(stop.matched, own, alignment), params.birds_eye)
        for stop, own in zip(stops, ties, strict=True)
    ]
    ties += [tie_cross_site(*two, params).ties for two in pairwise(views)]
    return Network(
        tuple(
            StopPrior(stop.stop, stop.matched.lsl_from_rover if k else stop.true)
            for k, stop in enumerate(stops)
        ),
        tuple(
            PairGeometry(pair.pair_id, stop.stop, pair.geometry)
            for stop in stops
            for pair in stop.matched.pairs
        ),
        build_tie_points(
            [pair.matches for stop in stops for pair in stop.matched.pairs], ties, TrackParams()
        ),
    )


def evaluated(
    stops: Sequence[SimulatedStop], *, surface_matching: bool = True
) -> tuple[AdjustmentReport, list[StopError]]:
    """The report of the overall adjustment, and the errors of all stops but the held one."""
    adjusted, report = adjust_overall(
        network_of(stops, surface_matching=surface_matching), AdjustmentParams()
    )
    places = np.array([stop.true.translation_m for stop in stops])
    driven_m = np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)).tolist()
    return report, [
        StopError.of(one, true, way)
        for one, true, way in zip(adjusted.stops[1:], stops[1:], driven_m, strict=True)
    ]


def world_folder(name: str) -> Path:
    """The folder of a rendered world; it does not exist for simulated ones."""
    return ROOT / ".cache" / "rendered_husband" if name == "husband" else Path(name)


def stops_of_world(name: str) -> list[SimulatedStop]:
    """The first stops of a world: `husband`, another rendered one's folder, or terrain and seed."""
    folder = world_folder(name)
    if folder.is_dir():
        return rendered_stops(folder)
    world = simulated_world(name)
    return [simulated_stop(world, number) for number in range(STOPS)]


def simulated_world(name: str) -> WorldOfStops:
    """A simulated world by terrain and seed, and whether it is realistic."""
    kind = name.removeprefix(REALISTIC)
    terrain = next(terrain for terrain in TERRAINS if kind.startswith(terrain))
    seed = int(kind.removeprefix(terrain))
    if kind == name:
        return WorldOfStops(terrain, NEAR if seed <= LAST_NEAR else FAR, seed)
    traverse = TraverseParams(stops=STOPS)
    like = realistic_params(WorldParams(terrain, traverse), seed)
    return WorldOfStops(terrain, traverse.spacing_m, seed, STOPS, like=like)


def main() -> None:
    """Read the names of worlds, adjust, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.stop_networks")
    parser.add_argument("worlds", nargs="+", help="husband, or a terrain and a seed: plains61")
    parser.add_argument(
        "--image-matched-alone", action="store_true", help="without surface matching"
    )
    arguments = parser.parse_args()
    for name in arguments.worlds:
        report, errors = evaluated(
            stops_of_world(name), surface_matching=not arguments.image_matched_alone
        )
        print(f"{name}: {report}", *errors, sep="\n", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
