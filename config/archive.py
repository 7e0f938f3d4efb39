"""The archive: URLs and volumes of each mission, and hosts for redirects."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from solmap.config.records import ConfigError, read_toml, record_of

SHIPPED = Path(__file__).parent / "archive.toml"
_SOLS = re.compile(r"\s*(\d{1,5})\s*(?:-\s*(\d{1,5})\s*)?\Z", re.ASCII)


@dataclass(frozen=True, slots=True)
class MissionArchive:
    """The archive of one mission."""

    title: str
    base_urls: tuple[str, ...]
    """Mirrors, tried in turn; each contains the volumes' folders."""
    volumes: Mapping[str, str]
    """Instrument, lower case -> volume."""
    index: str = "index/edrindex.lbl"
    """Path below a volume: label of its index table, or inventory (.csv) of a PDS4 collection."""
    raw_images: str = ""
    """Address of the public site's list of raw images; empty where there is none."""

    def __post_init__(self) -> None:
        if not self.base_urls:
            raise ValueError("base_urls should name at least one address")
        for url in self.urls:
            parts = urlsplit(url)
            if parts.scheme not in {"http", "https"} or not parts.hostname or parts.port == 0:
                raise ValueError(
                    f"base_urls and raw_images should be http or https addresses, not {url!r}"
                )

    @property
    def urls(self) -> tuple[str, ...]:
        """Every address of the mission."""
        return (*self.base_urls, self.raw_images) if self.raw_images else self.base_urls

    def volume(self, instrument: str) -> str:
        """The volume that holds an instrument's images.

        Raises:
            ConfigError: the archive has no volume of that instrument.
        """
        volume = self.volumes.get(instrument.lower())
        if volume is None:
            raise ConfigError(
                f"{self.title} has no instrument {instrument!r} in the archive; "
                f"name one of {', '.join(self.volumes)}"
            )
        return volume


@dataclass(frozen=True, slots=True)
class Archive:
    """The archives of all missions."""

    missions: Mapping[str, MissionArchive]
    redirect_hosts: tuple[str, ...] = ()
    transfer: Mapping[str, Any] = field(default_factory=dict)
    """The table of transfer parameters, whose record is in `tasks.fetch.transfer`."""

    @property
    def hosts(self) -> frozenset[str]:
        """The hosts that a redirect may lead to."""
        bases = (url for mission in self.missions.values() for url in mission.urls)
        return frozenset({*self.redirect_hosts, *(urlsplit(url).hostname or "" for url in bases)})

    def mission(self, name: str) -> MissionArchive:
        """The archive of one mission.

        Raises:
            ConfigError: there is none.
        """
        found = self.missions.get(name.upper())
        if found is None:
            raise ConfigError(
                f"the archive has no mission {name!r}; name one of {', '.join(self.missions)}, or "
                "add a table to the archive's file"
            )
        return found


def sols_of(text: str) -> frozenset[int]:
    """The sols of a text like 155-157,160.

    Raises:
        ConfigError: it does not name any.
    """
    sols: set[int] = set()
    for part in text.split(","):
        match = _SOLS.match(part)
        first = int(match[1]) if match else 1
        last = int(match[2] or match[1]) if match else 0
        if first > last:
            raise ConfigError(f"sols should be like 155, 155-157 or 155,160-162, but are {text!r}")
        sols.update(range(first, last + 1))
    return frozenset(sols)


def load_archive(path: Path = SHIPPED) -> Archive:
    """The archive from a TOML file.

    Raises:
        ConfigError: the file cannot be read, or a setting in it is wrong.
    """
    tables = read_toml(path)
    missions = tables.pop("missions", None)
    if not isinstance(missions, dict) or not missions:
        raise ConfigError(f"{path} should have a table [missions.NAME] for each mission")
    records = {
        name: record_of(MissionArchive, table, f"{path.name}: missions.{name}")
        for name, table in missions.items()
    }
    return record_of(Archive, {**tables, "missions": records}, path.name)
