"""Matches, parallax, ties and radiometric tables as compressed NumPy archives, read back.

The archives hold no dates, so the same arrays give the same bytes. Parallax is kept in whole steps
of 1/128 pixel (coarser only beyond 511 pixels), far below the resolution of matching; 0 means "not
matched". Its standard deviation is kept in one byte, in steps of three percent from 0.005 pixel.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from threading import Lock
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from solmap.photogrammetry.archive.images.radiometry import (
    Companding,
    FlatField,
    InverseTable,
    RadialVignetting,
    Radiometry,
)
from solmap.photogrammetry.arrays import ParallaxMap, UInt8, UInt16
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import StereoMatches
from solmap.photogrammetry.matching.records import DenseMatches, SharedSigma, Ties
from solmap.products.errors import ProductError

_STEP_PX = 1.0 / 128.0
_LARGEST = 65535
_LEAST_SIGMA_PX, _SIGMA_STEP = 0.005, 0.03

_READING = Lock()
"""One archive is read at a time: Python 3.11 fails, rarely, where two threads parse headers of
arrays at once."""

LEVEL = 1
"""Compression level: 6, the default of numpy, needs three times as long for a few percent of the
size."""


def write_archive(path: Path, header: dict[str, Any], **arrays: np.ndarray) -> None:
    """Write arrays and a header of plain JSON values."""
    text = np.frombuffer(json.dumps(header, sort_keys=True).encode(), dtype=np.uint8)
    with ZipFile(path, "w", ZIP_DEFLATED, compresslevel=LEVEL) as file:
        for name, array in {"header": text, **arrays}.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, np.asanyarray(array), allow_pickle=False)


def read_archive(
    path: Path, names: Collection[str] | None = None
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The header and arrays of an archive, all of them or those of some names.

    Raises:
        ProductError: the file is not an archive of solmap.
    """
    try:
        with _READING, np.load(path, allow_pickle=False) as archive:
            header = json.loads(archive["header"].tobytes())
            others = [name for name in archive.files if name != "header"]
            return header, {n: archive[n] for n in others if names is None or n in names}
    except (OSError, ValueError, KeyError) as error:
        raise ProductError(f"{path.name} is not an archive of arrays: {error}") from error


def finite(value: Any) -> Any:  # noqa: ANN401 - a figure, or a tuple of them
    """A number as a plain JSON value: null where not measured."""
    if isinstance(value, tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def frame_document(frame: Frame) -> dict[str, Any]:
    """A frame as plain JSON values."""
    return {"kind": str(frame.kind), "index": list(frame.index)}


def frame_of_document(document: dict[str, Any]) -> Frame:
    """The inverse of `frame_document`."""
    return Frame(FrameKind(document["kind"]), tuple(document["index"]))


def pose_document(pose: Pose) -> dict[str, Any]:
    """A pose as plain JSON values; the rotation matrix is kept exactly."""
    return {
        "target": frame_document(pose.target),
        "source": frame_document(pose.source),
        "rotation": pose.rotation.tolist(),
        "translation_m": pose.translation_m.tolist(),
    }


def pose_of_document(document: dict[str, Any]) -> Pose:
    """The inverse of `pose_document`."""
    return Pose(
        frame_of_document(document["target"]),
        frame_of_document(document["source"]),
        np.array(document["rotation"], dtype=np.float64),
        np.array(document["translation_m"], dtype=np.float64),
    )


def geometry_document(geometry: EpipolarPair) -> dict[str, Any]:
    """An epipolar geometry as plain JSON values."""
    return {
        "rover_from_pair": pose_document(geometry.rover_from_pair),
        "base_m": geometry.base_m,
        "focal_px": geometry.focal_px,
        "centre_px": list(geometry.centre_px),
        "samples": geometry.samples,
        "lines": geometry.lines,
        "mast_in_rover": geometry.mast_in_rover,
    }


def geometry_of_document(document: dict[str, Any]) -> EpipolarPair:
    """The inverse of `geometry_document`."""
    return EpipolarPair(
        rover_from_pair=pose_of_document(document["rover_from_pair"]),
        base_m=document["base_m"],
        focal_px=document["focal_px"],
        centre_px=(document["centre_px"][0], document["centre_px"][1]),
        samples=document["samples"],
        lines=document["lines"],
        mast_in_rover=_triple(document, "mast_in_rover"),
    )


def write_matches(
    path: Path,
    geometry: EpipolarPair,
    matches: StereoMatches,
    right_turn: tuple[float, float, float] | None = None,
) -> None:
    """Write the intra-stereo matches of a pair and the geometry they were measured in.

    Args:
        path: The file to write.
        geometry: The epipolar geometry.
        matches: The matches.
        right_turn: Rotation vector in the rover frame of the right camera from its label's
            model, so that rows correspond; None where they did.
    """
    header = {
        "pair": matches.pair_id,
        "geometry": geometry_document(geometry),
        "right_turn": right_turn,
    }
    write_archive(
        path, header, left=matches.left, parallax_px=matches.parallax_px, sigma_px=matches.sigma_px
    )


def read_matches(path: Path) -> tuple[EpipolarPair, StereoMatches]:
    """The geometry and matches written by `write_matches`."""
    header, arrays = read_archive(path)
    return geometry_of_document(header["geometry"]), StereoMatches(header["pair"], **arrays)


def read_right_turn(path: Path) -> tuple[float, float, float] | None:
    """The rotation of the right camera written by `write_matches`."""
    return _triple(read_archive(path, ())[0], "right_turn")


def _triple(document: dict[str, Any], name: str) -> tuple[float, float, float] | None:
    values = document.get(name)
    return (values[0], values[1], values[2]) if values else None


def write_dense(path: Path, dense: DenseMatches) -> None:
    """Write a dense parallax map and its standard deviations."""
    steps = np.fmax(dense.parallax_px, np.float32(0))  # where not matched, 0
    step = max(_STEP_PX, float(steps.max(initial=0.0)) / _LARGEST)
    np.rint(np.divide(steps, np.float32(step), out=steps), out=steps)
    codes = np.fmax(dense.sigma_px, np.float32(_LEAST_SIGMA_PX))
    np.log(np.divide(codes, np.float32(_LEAST_SIGMA_PX), out=codes), out=codes)
    np.rint(np.divide(codes, np.float32(_SIGMA_STEP), out=codes), out=codes)
    write_archive(
        path,
        {"step_px": step, **({"shared": asdict(dense.shared)} if dense.shared else {})},
        steps=np.minimum(steps, _LARGEST, out=steps).astype(np.uint16),
        sigma=np.minimum(codes, 255, out=codes).astype(np.uint8),
    )


@dataclass(frozen=True, slots=True, eq=False)
class StoredParallax:
    """A dense parallax map as it is stored, in a third of its memory; read only."""

    steps: UInt16[np.ndarray, "lines samples"]
    """Parallax in steps; 0 where not matched."""
    sigmas: UInt8[np.ndarray, "lines samples"]
    """Standard deviation, by its place in a table."""
    step_px: float
    shared: SharedSigma | None

    @classmethod
    def read(cls, path: Path) -> StoredParallax:
        """The inverse of `write_dense`.

        Raises:
            ProductError: the file is not an archive of solmap.
        """
        header, arrays = read_archive(path)
        for array in arrays.values():
            array.setflags(write=False)
        shared = SharedSigma(**header["shared"]) if "shared" in header else None
        return cls(arrays["steps"], arrays["sigma"], header["step_px"], shared)

    def parallax_px(self) -> ParallaxMap:
        """The parallax in pixels; NaN where not matched."""
        values = self.steps * np.float32(self.step_px)
        return np.where(self.steps > 0, values, np.float32(np.nan))

    def sigma_px(self) -> ParallaxMap:
        """Standard deviation of the parallax in pixels; NaN where not matched."""
        table = np.float32(_LEAST_SIGMA_PX) * np.exp(np.arange(256) * np.float32(_SIGMA_STEP))
        sigma = table.astype(np.float32)[self.sigmas]
        sigma[self.steps == 0] = np.nan
        return sigma

    def dense(self) -> DenseMatches:
        """Both as matched."""
        return DenseMatches(self.parallax_px(), self.sigma_px(), self.shared)


_COLUMNS = {"surface_matched": "by_shape"}
"""Columns of ties that have another name in files."""


def write_ties(path: Path, ties: Ties, header: dict[str, Any]) -> None:
    """Write ties between stereo pairs with a header of figures."""
    columns = {_COLUMNS.get(f.name, f.name): getattr(ties, f.name) for f in fields(ties)[1:]}
    write_archive(path, {**header, "pair_ids": list(ties.pair_ids)}, **columns)


def read_ties(path: Path) -> tuple[Ties, dict[str, Any]]:
    """The inverse of `write_ties`."""
    header, arrays = read_archive(path)
    names = {stored: name for name, stored in _COLUMNS.items()}
    columns = {names.get(stored, stored): array for stored, array in arrays.items()}
    return Ties(tuple(header.pop("pair_ids")), **columns), header


def radiometry_digest(radiometry: Radiometry) -> str:
    """SHA-256 of its content: equal for equal tables of any origin."""
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
    """The inverse of `write_radiometry`.

    Raises:
        ProductError: the file is not an archive of solmap.
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
