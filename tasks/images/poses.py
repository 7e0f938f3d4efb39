"""Poses of stops from other sources than labels: files named by people, stored as vector files.

PLACES tables, location files, vector files, poses CSV and SPICE kernels become vector files in the
store, one per file, with a standard deviation of every pose; the latest file of a name is used.
Images whose labels lack the attitude of the rover get it from these files.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from solmap.photogrammetry.archive.images.json_metadata import with_attitude
from solmap.photogrammetry.archive.images.record_json import START as RECORD
from solmap.photogrammetry.archive.labels.detached import (
    LabelKind,
    decode_label,
    join_label,
    kind_of_label,
    split_label,
)
from solmap.photogrammetry.archive.missions import mission_id
from solmap.photogrammetry.archive.tables.places import (
    LOCALISED,
    PRIORITY,
    SPICE,
    parse_localisations,
)
from solmap.photogrammetry.archive.tables.pose_table import PoseRow, is_pose_table, parse_poses
from solmap.photogrammetry.archive.tables.spice_kernels import SUFFIXES, Kernels, open_kernels
from solmap.photogrammetry.archive.tables.vector_files import (
    Solution,
    VectorFile,
    check_pose,
    parse_vector_file,
    ranked,
    vector_text,
)
from solmap.photogrammetry.arrays import Quaternion
from solmap.photogrammetry.errors import VectorFileError
from solmap.photogrammetry.frames import FrameKind
from solmap.photogrammetry.imagery import RoverImage, StopId
from solmap.products.catalogue.catalogue import ImageEntry, Outcome
from solmap.products.catalogue.images import image_record
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef
from solmap.products.store.user_files import MAX_ROWS_BYTES, read_user_file
from solmap.tasks.images.files import keep_file
from solmap.tasks.images.telemetry import read_vector_file


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """A file as read, with its date."""

    name: str
    written: str
    """UTC, ISO 8601."""
    stated: VectorFile | None = None
    """Its mission is empty if the file does not name one."""
    rows: tuple[PoseRow, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PoseSources:
    """Files with poses, read; kernels are loaded."""

    tables: tuple[_Table, ...] = ()
    kernels: Kernels | None = None
    others: tuple[VectorFile, ...] = ()
    """Delivered vector files, of any mission."""

    @property
    def names(self) -> str:
        """The names of the files, separated by commas."""
        kernels = [self.kernels.names] if self.kernels else []
        return ", ".join([*(table.name for table in self.tables), *kernels])

    @property
    def missions(self) -> tuple[str, ...]:
        """The missions of the files, if all name one."""
        named = [mission_id(table.stated.mission) for table in self.tables if table.stated]
        is_all = len(named) == len(self.tables) and not self.kernels
        return tuple(dict.fromkeys(named)) if is_all and all(named) else ()

    def beside(self, vectors: Iterable[ProductRef], workspace: Workspace) -> PoseSources:
        """These poses together with delivered vector files and those in the catalogue."""
        refs = [*vectors, *workspace.catalogue.pointers(ProductKind.VECTORS)]
        found: list[VectorFile] = []
        for ref in dict.fromkeys(ref for ref in refs if ref.kind is ProductKind.VECTORS):
            with suppress(VectorFileError):  # stored by an earlier version
                found.append(read_vector_file(ref, workspace))
        return replace(self, others=tuple(found))

    def with_attitude(self, data: bytes, name: str) -> bytes:
        """An image with the attitude from these sources, where its metadata lack one.

        Raises:
            LabelError: its metadata are broken.
            VectorFileError: required SPICE kernels are missing.
        """
        label, pixels = split_label(data, name)
        text = "" if label is None else decode_label(label)
        if not text or text.startswith(RECORD) or kind_of_label(text) is not LabelKind.METADATA:
            return data
        stated = with_attitude(text, name, self._attitude_of)
        return data if stated is text else join_label(stated.encode(), pixels, name)

    def _attitude_of(self, image: RoverImage) -> Quaternion | None:
        """Attitude of the rover at an image: rover into north, east, down."""
        stop = image.stop
        for row in (row for table in self.tables for row in table.rows):
            is_here = (row.site, row.drive) == (stop.site, stop.drive) or row.image == image.id
            if is_here and row.quaternion is not None:
                return row.quaternion
        stated = [table.stated for table in self.tables if table.stated]
        others = [file for file in self.others if mission_id(file.mission) == stop.mission]
        for one in (*ranked(stated), *ranked(others)):
            if one.frame == stop.frame:
                return one.quaternion
        found = self.kernels.pose(stop.mission, image.clock) if self.kernels else None
        return found[0] if found else None


@contextmanager
def open_pose_sources(files: Sequence[Path]) -> Iterator[PoseSources]:
    """Read files with poses, of any kind.

    Raises:
        VectorFileError: one is of no known kind, or a row of it is broken.
        OSError: one cannot be read.
    """
    kernels = [file for file in files if file.suffix.lower() in SUFFIXES]
    with ExitStack() as opened:
        loaded = opened.enter_context(open_kernels(kernels)) if kernels else None
        tables = [_read(file) for file in files if file not in kernels]
        yield PoseSources(tuple(tables), loaded)


def _read(file: Path) -> _Table:
    text = read_user_file(file, most_bytes=MAX_ROWS_BYTES).decode("utf-8", "replace")
    written = datetime.fromtimestamp(file.stat().st_mtime, UTC).isoformat(timespec="seconds")
    if "<rmc_file" in text:
        return _Table(file.name, written, parse_vector_file(text, file.name))
    if is_pose_table(text):
        return _Table(file.name, written, rows=parse_poses(text, file.name))
    return _Table(file.name, written, parse_localisations(text, file.name, mission=""))


def take_poses(sources: PoseSources, mission: str, workspace: Workspace) -> list[str]:
    """Store the poses of a mission's stops from the sources; returns a line on each source.

    Raises:
        VectorFileError: a pose is impossible.
    """
    first: dict[StopId, ImageEntry] = {}
    for entry in sorted(workspace.catalogue.images(), key=lambda entry: (entry.sol, entry.id)):
        if entry.stop_id.mission == mission:
            first.setdefault(entry.stop_id, entry)
    lines: list[str] = []
    for table in sources.tables:
        taken, notes = table.stated, list[str]()
        if table.rows:
            taken, notes = _of_rows(table, mission, first, workspace)
        if taken is not None:
            lines.append(_keep(replace(taken, mission=taken.mission or mission), workspace))
        lines += notes
    if sources.kernels is not None:
        lines.append(_take_kernels(sources.kernels, mission, first, workspace))
    return lines


def _keep(file: VectorFile, workspace: Workspace) -> str:
    ref = keep_file(ProductKind.VECTORS, file.source, vector_text(file).encode(), workspace.store)
    line = f"{file.source}: {len(file.solutions)} sites and stops; the next run uses them for maps"
    workspace.catalogue.publish(pointers=[ref], outcomes=[Outcome.now(file.source, (line,))])
    return line


def _of_rows(
    table: _Table,
    mission: str,
    first: Mapping[StopId, ImageEntry],
    workspace: Workspace,
) -> tuple[VectorFile | None, list[str]]:
    """The rows of a poses CSV as a vector file, and a line on each that is left out."""
    solutions, notes = [], []
    stops = {entry.id: entry.stop_id for entry in workspace.catalogue.images()}
    for row in table.rows:
        if row.site is not None and row.drive is not None:
            stop: StopId | None = StopId(mission, row.site, row.drive)
        else:
            stop = stops.get(row.image or "")
        if stop is None or (row.quaternion is None and stop not in first):
            what = row.image if stop is None else str(stop)
            notes.append(
                f"{row.where}: no image {'' if stop is None else 'of '}{what} is in the store; "
                f"`solmap run FOLDER --places {table.name}` ingests both"
            )
            continue
        quaternion = row.quaternion
        if quaternion is None:
            quaternion = image_record(first[stop], workspace).site_from_rover.quaternion
        solution = Solution(
            LOCALISED,
            FrameKind.ROVER,
            (stop.site, stop.drive),
            stop.site if row.reference_site is None else row.reference_site,
            row.position_m,
            quaternion,
            table.written,
            row.sigma_m,
            row.sigma_deg,
        )
        check_pose(solution, row.where)
        solutions.append(solution)
    if not solutions:
        return None, notes
    return VectorFile(table.name, mission, "rvf", PRIORITY, tuple(solutions)), notes


def _take_kernels(
    kernels: Kernels, mission: str, first: Mapping[StopId, ImageEntry], workspace: Workspace
) -> str:
    """Store the poses of SPICE kernels at the first image of every stop."""
    solutions = []
    for stop, entry in first.items():
        found = kernels.pose(mission, image_record(entry, workspace).clock)
        if found is not None:
            quaternion, place_m = found
            counter = (stop.site, stop.drive)
            solutions.append(Solution(SPICE, FrameKind.ROVER, counter, 0, place_m, quaternion, ""))
            check_pose(solutions[-1], kernels.names)
    if not solutions:
        raise VectorFileError(
            f"{kernels.names}: they cover none of the {len(first)} stops of {mission} in the store"
        )
    name = f"{SPICE}-{mission.lower()}"
    return _keep(VectorFile(name, mission, "rvf", PRIORITY, tuple(solutions)), workspace)
