"""Landing points: position of each mission's map on Mars, with its source."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from solmap.config.records import ConfigError, read_toml, record_of
from solmap.products.crs import LandingPoint, nowhere
from solmap.products.model import mission_of, origin_of

SHIPPED = Path(__file__).parent / "landing_sites.toml"


@dataclass(frozen=True, slots=True)
class LandingSite:
    """A mission's title and landing point."""

    title: str
    landing: LandingPoint


def landing_sites(path: Path = SHIPPED) -> dict[str, LandingSite]:
    """Landing sites by the identifier of their mission, from a TOML file.

    Raises:
        ConfigError: the file cannot be read or a table is not a landing site.
    """
    from solmap.photogrammetry.archive.missions import mission_id  # noqa: PLC0415 - lists need none

    sites = {}
    for mission, table in read_toml(path).items():
        if not isinstance(table, dict):
            raise ConfigError(
                f"{path} should have a table [MISSION] for each mission, not {mission}"
            )
        title = str(table.pop("title", mission))
        sites[mission_id(mission)] = LandingSite(
            title, record_of(LandingPoint, table, f"{path}: {mission}")
        )
    return sites


def landing_site(mission: str, path: Path = SHIPPED) -> LandingSite:
    """The landing site of one mission, or the origin of a map that is not tied to the lander.

    A mission without a table, such as an own stereo rig, is mapped in its own frame.

    Raises:
        ConfigError: the file cannot be read, or does not contain landing sites.
    """
    origin = origin_of(mission)
    if origin:
        site = landing_site(mission_of(mission), path)
        numbers = zip(("site", "drive"), origin, strict=False)
        landing = site.landing.untied(" ".join(f"{what} {number}" for what, number in numbers))
        return LandingSite(f"{site.title} ({landing.name})", landing)
    from solmap.photogrammetry.archive.missions import mission_id  # noqa: PLC0415 - as above

    sites, mission = landing_sites(path), mission_id(mission)
    if mission not in sites:
        return LandingSite(mission, nowhere(f"{path.name} has no table [{mission}]"))
    return sites[mission]
