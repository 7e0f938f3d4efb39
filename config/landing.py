"""Landing points: where each mission's map is tied to Mars, each with its source."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from solmap.config.records import ConfigError, read_toml, record_of
from solmap.products.crs import LandingPoint

SHIPPED = Path(__file__).parent / "landing_sites.toml"


@dataclass(frozen=True, slots=True)
class LandingSite:
    """A mission's title and landing point."""

    title: str
    landing: LandingPoint


def landing_sites(path: Path = SHIPPED) -> dict[str, LandingSite]:
    """Landing sites by mission, from a TOML file.

    Raises:
        ConfigError: the file cannot be read or a table is not a landing site.
    """
    sites = {}
    for mission, table in read_toml(path).items():
        if not isinstance(table, dict):
            raise ConfigError(
                f"{path} should have a table [MISSION] for each mission, not {mission}"
            )
        title = str(table.pop("title", mission))
        sites[mission] = LandingSite(title, record_of(LandingPoint, table, f"{path}: {mission}"))
    return sites


def landing_site(mission: str, path: Path = SHIPPED) -> LandingSite:
    """The landing site of one mission.

    Raises:
        ConfigError: the file has no table for it.
    """
    sites = landing_sites(path)
    if mission not in sites:
        raise ConfigError(
            f"{path} has no landing point for mission {mission}; add a table [{mission}] with "
            "name, longitude, latitude, radius_m and source"
        )
    return sites[mission]
