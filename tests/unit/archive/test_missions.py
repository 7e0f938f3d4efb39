"""A mission has one identifier, whatever people and labels call it."""

import pytest

from solmap.config.landing import landing_site, landing_sites
from solmap.photogrammetry.archive.missions import MISSIONS, mission_id
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.terrain.dtm.rover_body import BODIES


@pytest.mark.parametrize(
    ("identifier", "names"),
    {
        "MER2": ("MER2", "mer2", "Spirit", "MER-A", " mer a "),
        "MER1": ("MER1", "opportunity", "MER-B"),
        "MSL": ("msl", "Curiosity"),
        "M20": ("M20", "m2020", "Mars 2020", "MARS-2020", "Perseverance"),
        "LRO": ("lro",),
    }.items(),
)
def test_names_of_a_mission(identifier, names):
    assert {mission_id(name) for name in names} == {identifier}


@pytest.mark.parametrize("camera", ["CHEMCAM_RMI", "SUPERCAM_RMI"])
def test_a_remote_micro_imager_has_one_eye(camera):
    (of,) = (mission.instruments for mission in MISSIONS if camera in mission.instruments)
    assert of[camera] == (camera, Eye.MONO)


def test_every_host_has_a_landing_site_under_its_identifier():
    identifiers = {mission_id(host) for mission in MISSIONS for host in mission.hosts}
    assert identifiers <= set(landing_sites())
    assert identifiers == set(BODIES)
    assert landing_site("M2020") == landing_site("Perseverance") == landing_site("M20")
