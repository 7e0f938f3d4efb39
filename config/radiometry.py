"""Inverse tables, vignetting and flat fields of each mission's cameras.

They are set in TOML files, one per mission, in the folder `SOLMAP_INSTRUMENTS`:

    hosts = ["MER2"]                                    INSTRUMENT_HOST_ID of its labels
    companding.approximate = false                      whether the square root may replace a table
    companding.tables.LUT3 = {counts = [...], source = "..."}
    vignetting.NAVCAM_LEFT = {k1 = -0.1, source = "..."}      by INSTRUMENT_ID
    flat_fields.NAVCAM_RIGHT = "calib/right.img"        an image of an even source, below the folder
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from solmap.config.records import ConfigError, read_toml, record_of
from solmap.photogrammetry.archive.images.pixels import read_pixels
from solmap.photogrammetry.archive.images.radiometry import (
    Companding,
    FlatField,
    InverseTable,
    RadialVignetting,
    Radiometry,
)
from solmap.photogrammetry.archive.images.reading import read_label
from solmap.photogrammetry.errors import PhotogrammetryError, PixelError
from solmap.products.store.user_files import read_user_file

TABLES = frozenset({"hosts", "companding", "vignetting", "flat_fields"})


def load_radiometry(folder: Path) -> dict[str, Radiometry]:
    """Tables of the cameras of each spacecraft, by INSTRUMENT_HOST_ID.

    Raises:
        ConfigError: the folder does not exist, or a file cannot be read or contains anything but
            tables, models and flat fields.
    """
    if not folder.is_dir():
        raise ConfigError(
            f"{folder} is not a folder; it should contain a TOML file for each mission"
        )
    found: dict[str, Radiometry] = {}
    for path in sorted(folder.glob("*.toml")):
        content = read_toml(path)
        unknown = sorted(set(content) - TABLES)
        if unknown:
            raise ConfigError(f"{path} has no setting {unknown[0]!r}; it has {sorted(TABLES)}")
        for host in _hosts(content, path):
            if host in found:
                raise ConfigError(f"{path}: {host} is in the hosts of another file, too")
            found[host] = _radiometry(content, path)
    return found


def _hosts(content: dict[str, Any], path: Path) -> list[str]:
    hosts = content.get("hosts")
    if not isinstance(hosts, list) or not all(isinstance(host, str) for host in hosts):
        raise ConfigError(f"{path}: hosts should be a list of spacecraft, like ['MER1', 'MER2']")
    return hosts


def _radiometry(content: dict[str, Any], path: Path) -> Radiometry:
    companding = dict(_table_of(content, "companding", path))
    tables = companding.pop("tables", {})
    approximate = companding.pop("approximate", False)
    if companding or not isinstance(approximate, bool) or not isinstance(tables, dict):
        raise ConfigError(f"{path}: companding has approximate (true or false) and tables")
    models = {
        camera: record_of(RadialVignetting, table, f"{path}: {camera}")
        for camera, table in _table_of(content, "vignetting", path).items()
    }
    measured = {
        camera: _flat_field(path.parent / str(file), f"{path}: {camera}")
        for camera, file in _table_of(content, "flat_fields", path).items()
    }
    both = sorted(set(models) & set(measured))
    if both:
        raise ConfigError(f"{path}: {both[0]} has a flat field and a model of it; keep one")
    return Radiometry(
        Companding(
            {
                name: _inverse_table(name, table, f"{path}: {name}")
                for name, table in tables.items()
            },
            approximate,
        ),
        {**models, **measured},
    )


def _table_of(content: dict[str, Any], name: str, path: Path) -> dict[str, Any]:
    table = content.get(name, {})
    if not isinstance(table, dict):
        raise ConfigError(f"{path}: {name} should be a table, not {table!r:.40}")
    return table


def _inverse_table(name: str, table: Any, where: str) -> InverseTable:  # noqa: ANN401 - any setting
    if not isinstance(table, dict) or set(table) != {"counts", "source"}:
        raise ConfigError(f"{where}: an inverse table has counts and source, not {table!r:.60}")
    try:
        counts = np.array(table["counts"], dtype=np.float32)
        return InverseTable(name, counts, str(table["source"]))
    except (PixelError, TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{where}: {error}") from error


def _flat_field(file: Path, where: str) -> FlatField:
    """An image of an even source, scaled to 1 at its median in the middle."""
    try:
        data = read_user_file(file)
        pixels, mask = read_pixels(data, read_label(data, file.name), file.name)
    except (OSError, PhotogrammetryError) as error:
        raise ConfigError(f"{where}: {error}") from error
    lines, samples = pixels.shape
    middle = pixels[lines // 4 : -(-3 * lines // 4), samples // 4 : -(-3 * samples // 4)]
    level = float(np.median(middle))
    if not (mask & (pixels > 0)).all() or level <= 0:
        raise ConfigError(f"{where}: {file.name} has pixels without light: not a flat field")
    return pixels / np.float32(level)
