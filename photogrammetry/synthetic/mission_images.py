"""The images of a simulated mission: what their labels say, for there are no pixels.

Stops are drives of one site, so that telemetry needs no chain of sites; a stop takes a panorama of
Navcam pairs a sol, and its first exposure names the pair in the network. The label's cameras are
those of the mast (`rig`), turned as the network's pairs are; their axes differ from those of the
simulated pairs by a degree or two, so footprints are a rover's and tie points are the simulation's.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.frames import Pose, site_frame
from solmap.photogrammetry.imagery import Eye, StopId
from solmap.photogrammetry.synthetic.edr import Exposure
from solmap.photogrammetry.synthetic.mission import MissionPlan, Names, SimulatedMission
from solmap.photogrammetry.synthetic.networks import ELEVATION_DEG
from solmap.photogrammetry.synthetic.rig import CAMERAS, Instrument, Pointing
from solmap.photogrammetry.synthetic.traverse import solar_longitude, sun_at

MISSION = "MER2"
SITE, DRIVES = 0, 2
"""The site of all stops, and by how much their drive counter goes up."""
MOST_STOPS = 500
"""Beyond a drive counter of 1295 file names cannot tell stops apart."""
FIRST_CLOCK, SOL_S, PAIR_S = 126_000_000, 88_775, 60
HOUR = 12.0
SEQUENCE = "P0703"


def mission_names(plan: MissionPlan) -> Names:
    """Names of stops and pairs as the archive has them: pairs are called as their left images.

    Raises:
        PhotogrammetryError: more stops than file names can tell apart.
    """
    if plan.stops > MOST_STOPS:
        raise PhotogrammetryError(
            f"file names of {MISSION} tell {MOST_STOPS} stops of a site apart, not {plan.stops}"
        )
    return Names(_stop, lambda stop, pair: _exposure(stop, pair, plan, Eye.LEFT).product_id)


def exposures(mission: SimulatedMission, plan: MissionPlan) -> Iterator[tuple[Exposure, Exposure]]:
    """Left and right exposure of every pair, with the attitude and place that telemetry reports."""
    for stop, prior in enumerate(mission.network.stops):
        told = prior.lsl_from_rover
        pose = Pose(site_frame(SITE), told.source, told.rotation, told.translation_m)
        for pair in range(plan.pairs_per_stop):
            yield (
                _exposure(stop, pair, plan, Eye.LEFT, pose),
                _exposure(stop, pair, plan, Eye.RIGHT, pose),
            )


def _stop(k: int) -> StopId:
    return StopId(MISSION, SITE, DRIVES * k)


def _exposure(
    stop: int, pair: int, plan: MissionPlan, eye: Eye, site_from_rover: Pose | None = None
) -> Exposure:
    name, sol = _stop(stop), stop + 1
    pointing = Pointing(2 * np.pi * pair / plan.pairs_per_stop, float(np.radians(ELEVATION_DEG)))
    return Exposure(
        stop=name,
        sol=sol,
        local_solar_hour=HOUR + pair * PAIR_S / 3600,
        solar_longitude=solar_longitude(sol),
        sun=sun_at(sol, HOUR),
        site_from_rover=site_from_rover or Pose.identity(site_frame(SITE), name.frame),
        instrument=Instrument.NAVCAM,
        eye=eye,
        pointing=pointing,
        camera=CAMERAS[Instrument.NAVCAM, eye].in_mast.moved(pointing.rover_from_mast(name)),
        clock=FIRST_CLOCK + SOL_S * sol + PAIR_S * pair,
        pma=pair + 1,
        sequence=SEQUENCE,
    )
