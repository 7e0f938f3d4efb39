"""Inverse tables and vignetting of each mission's cameras, from `config/instruments/*.toml`."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from config.errors import ConfigError
from config.records import record_of
from photogrammetry.errors import PixelError
from photogrammetry.pds3.companding import Companding, InverseTable
from photogrammetry.pds3.reading import Radiometry
from photogrammetry.pds3.vignetting import RadialVignetting

SHIPPED = Path(__file__).parent / "instruments"
TABLES = frozenset({"hosts", "companding", "vignetting"})


def radiometry_of(mission: str, folder: Path = SHIPPED) -> Radiometry:
    """What is known of the cameras of a spacecraft; nothing where no file names it.

    Raises:
        ConfigError: a file cannot be read, or holds what is no table or model.
    """
    for path in sorted(folder.glob("*.toml")):
        try:
            content = tomllib.loads(path.read_text())
        except (OSError, tomllib.TOMLDecodeError) as error:
            raise ConfigError(f"{path}: {error}") from error
        unknown = sorted(set(content) - TABLES)
        if unknown:
            raise ConfigError(f"{path} has no setting {unknown[0]!r}; it has {sorted(TABLES)}")
        if mission in content.get("hosts", []):
            return _radiometry(content, str(path))
    return Radiometry()


def _radiometry(content: dict[str, Any], where: str) -> Radiometry:
    companding = dict(content.get("companding", {}))
    tables = companding.pop("tables", {})
    approximate = companding.pop("approximate", False)
    if companding or not isinstance(approximate, bool):
        raise ConfigError(f"{where}: companding has approximate (true or false) and tables")
    return Radiometry(
        companding=Companding(
            {name: _table(name, table, f"{where}: {name}") for name, table in tables.items()},
            approximate,
        ),
        flat_fields={
            instrument: record_of(RadialVignetting, table, f"{where}: {instrument}")
            for instrument, table in content.get("vignetting", {}).items()
        },
    )


def _table(name: str, table: dict[str, Any], where: str) -> InverseTable:
    if set(table) != {"counts", "source"}:
        raise ConfigError(f"{where}: an inverse table has counts and source, not {sorted(table)}")
    try:
        counts = np.array(table["counts"], dtype=np.float32)
        return InverseTable(name, counts, str(table["source"]))
    except (PixelError, TypeError, ValueError) as error:
        raise ConfigError(f"{where}: {error}") from error
