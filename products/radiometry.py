"""Inverse tables and flat fields as a product: what pixels are read with, written and read back."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from solmap.photogrammetry.archive.companding import Companding, InverseTable
from solmap.photogrammetry.archive.radiometry import Radiometry
from solmap.photogrammetry.archive.vignetting import FlatField, RadialVignetting
from solmap.products.formats.documents.archives import read_archive, write_archive


def radiometry_digest(radiometry: Radiometry) -> str:
    """SHA-256 of all that it holds: equal for equal tables, wherever they came from."""
    header, arrays = _documents(radiometry)
    digest = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].shape} ".encode())
        digest.update(np.ascontiguousarray(arrays[name], dtype="<f4").tobytes())
    return digest.hexdigest()


def write_radiometry(path: Path, radiometry: Radiometry) -> None:
    """Write tables and flat fields as an archive of arrays."""
    header, arrays = _documents(radiometry)
    write_archive(path, header, **arrays)


def read_radiometry(path: Path) -> Radiometry:
    """The twin of `write_radiometry`.

    Raises:
        ProductError: the file is no archive of ours.
    """
    header, arrays = read_archive(path)
    tables = {
        table["name"]: InverseTable(
            counts=arrays[f"table{number}"],
            **table,
        )
        for number, table in enumerate(header["tables"])
    }
    flat_fields = {camera: _model(model) for camera, model in header["models"].items()}
    fields = {camera: arrays[f"flat{k}"] for k, camera in enumerate(header["flat_fields"])}
    return Radiometry(Companding(tables, header["approximate"]), {**flat_fields, **fields})


def _documents(radiometry: Radiometry) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    companding = radiometry.companding
    tables = [companding.tables[name] for name in sorted(companding.tables)]
    models: dict[str, dict[str, Any]] = {}
    measured: dict[str, FlatField] = {}
    for camera, flat in sorted(radiometry.flat_fields.items()):
        if isinstance(flat, RadialVignetting):
            models[camera] = asdict(flat)
        else:
            measured[camera] = flat
    header = {
        "approximate": companding.approximate,
        "tables": [
            {"name": t.name, "source": t.source, "is_approximation": t.is_approximation}
            for t in tables
        ],
        "models": models,
        "flat_fields": list(measured),
    }
    arrays = {f"table{number}": table.counts for number, table in enumerate(tables)}
    return header, arrays | {f"flat{k}": flat for k, flat in enumerate(measured.values())}


def _model(document: dict[str, Any]) -> RadialVignetting:
    centre = document["centre"]
    return RadialVignetting(**{**document, "centre": None if centre is None else tuple(centre)})
