"""Fetch stereo pairs from the archive: first its index, then the listed images that are missing.

For Curiosity and Perseverance, the public raw images of mars.nasa.gov with their metadata can be
fetched instead. Images are written to `OUT/sol####/`, indices and the state of transfers to
`OUT/.fetch/`. A second call fetches only missing files, and continues interrupted transfers.
"""

from __future__ import annotations

import fcntl
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from prefect import flow

from solmap.config.archive import MissionArchive, load_archive, sols_of
from solmap.config.records import ConfigError, record_of
from solmap.config.settings import Settings
from solmap.flows.runtime.progress import report as report_progress
from solmap.photogrammetry.archive.tables.volume_index import (
    IndexFindings,
    IndexSelection,
)
from solmap.tasks.fetch.answers import FetchError, open_client
from solmap.tasks.fetch.images import Arrival, fetch_images, is_whole, target_of
from solmap.tasks.fetch.index import Index, Volume, fetch_index
from solmap.tasks.fetch.raw_images import fetch_raw_images, find_raw_images, is_raw_image_here
from solmap.tasks.fetch.transfer import Transfer, TransferParams

STATE = ".fetch"
"""Folder of indices and state, inside the folder of images."""


@dataclass(slots=True)
class FetchReport:
    """Result of a fetch."""

    is_dry: bool = False
    pairs: int = 0
    unpaired: int = 0
    fetched: int = 0
    already_here: int = 0
    received_bytes: int = 0
    files: list[str] = field(default_factory=list)
    """Images found by a dry run, one line per file."""
    warnings: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    @property
    def succeeded(self) -> bool:
        """Whether everything requested is present."""
        return not self.failures

    @property
    def lines(self) -> list[str]:
        """A summary in one line, in a dry run preceded by the list of files."""
        found = f"{self.pairs} stereo pairs ({self.unpaired} images have no partner)"
        here = f"{self.already_here} images were here already"
        if self.is_dry:
            return [*self.files, f"{found}; {here}"]
        size = self.received_bytes / 1e6
        failed = f", {len(self.failures)} failed" if self.failures else ""
        return [f"{found}; {self.fetched} images fetched ({size:.1f} MB), {here}{failed}"]


@flow(name="fetch-archive", flow_run_name="fetch {mission} sol {sols}")
def fetch_archive(  # noqa: PLR0913 - options of the command
    mission: str,
    sols: str,
    instruments: list[str],
    out_dir: Path,
    *,
    dry_run: bool = False,
    archive_file: Path | None = None,
    raw: bool = False,
) -> FetchReport:
    """Fetch the stereo pairs of some sols; a file that fails does not stop the others.

    Args:
        mission: MER1, MER2, MSL or M20.
        sols: 155, 155-157, or several of these separated by commas.
        instruments: Any of navcam, pancam, mastcam, hazcam, front_hazcam, rear_hazcam.
        out_dir: Folder for the images.
        dry_run: Only list the images.
        archive_file: TOML file of URLs; by default that of the settings.
        raw: Fetch public raw images with their metadata, not the archive's EDRs.

    Raises:
        ConfigError: no such mission, instrument or sols.
        FetchError: an index is not available, or the folder cannot be written.
    """
    file = archive_file or Settings().archive
    archive = load_archive(file)
    params = record_of(TransferParams, dict(archive.transfer), f"{file.name}: transfer")
    of_mission, days = archive.mission(mission), sols_of(sols)
    if raw and not of_mission.raw_images:
        raise ConfigError(f"{of_mission.title} has no list of public raw images; leave out --raw")
    selections = [
        (None if raw else _volume(of_mission, name), IndexSelection(mission.upper(), name, days))
        for name in dict.fromkeys(instruments)
    ]
    report = FetchReport(is_dry=dry_run)
    client = open_client(params.timeout_s, params.connections)
    with _exclusive(out_dir), client:
        transfer = Transfer(client, archive.hosts, params)
        for volume, selection in selections:
            if volume is None:
                _fetch_raw(of_mission.raw_images, selection, out_dir, transfer, report)
            else:
                _fetch_volume(volume, selection, out_dir, transfer, report)
    return report


def _volume(found: MissionArchive, instrument: str) -> Volume:
    return Volume(found.volume(instrument), found.base_urls, found.index)


def _fetch_raw(
    url: str, selection: IndexSelection, out_dir: Path, transfer: Transfer, report: FetchReport
) -> None:
    """Fetch the public raw images of one instrument: search their list, then fetch the pairs."""
    found = find_raw_images(url, selection, out_dir / STATE / "raw", transfer)
    report.pairs += len(found.images) // 2
    report.unpaired += found.unpaired
    if found.left_out:
        report.warnings.append(
            f"{found.left_out} raw images cannot be placed; the first: {found.first_fault}"
        )
    if not found.images:
        report.failures.append(
            f"the list of raw images has no stereo pair of {selection.instrument} on sols "
            f"{min(selection.sols)} to {max(selection.sols)}"
        )
    if report.is_dry:
        here = [is_raw_image_here(image, out_dir) for image in found.images]
        _list([image.path(out_dir) for image in found.images], here, out_dir, report)
        return
    arrivals = fetch_raw_images(
        found.images,
        out_dir,
        transfer,
        lambda done, total: report_progress(f"{selection.instrument} images", done, total),
    )
    _note_arrivals(arrivals, report)


def _fetch_volume(
    volume: Volume,
    selection: IndexSelection,
    out_dir: Path,
    transfer: Transfer,
    report: FetchReport,
) -> None:
    """Fetch the images of one instrument: search its index, then fetch the pairs."""
    index = fetch_index(
        volume,
        out_dir / STATE / volume.name,
        transfer,
        lambda done, total: report_progress(f"index of {volume.name}, MiB", done, total),
    )
    findings = index.find(selection)
    _note_findings(findings, index, selection, report)
    if report.is_dry:
        paths = [target_of(entry, out_dir) for entry in findings.entries]
        _list(paths, [is_whole(path) for path in paths], out_dir, report)
        return
    arrivals = fetch_images(
        findings.entries,
        index.volume,
        out_dir,
        transfer,
        lambda done, total: report_progress(f"{selection.instrument} images", done, total),
    )
    _note_arrivals(arrivals, report)


def _note_arrivals(arrivals: Sequence[Arrival], report: FetchReport) -> None:
    report.failures += [arrival.failure for arrival in arrivals if arrival.failure]
    report.already_here += sum(arrival.was_here for arrival in arrivals)
    report.fetched += sum(not (arrival.was_here or arrival.failure) for arrival in arrivals)
    report.received_bytes += sum(arrival.received_bytes for arrival in arrivals)


def _note_findings(
    findings: IndexFindings, index: Index, selection: IndexSelection, report: FetchReport
) -> None:
    """Report the number of pairs in the index, and its inconsistencies."""
    report.pairs += len(findings.pairs)
    report.unpaired += len(findings.unpaired)
    if index.warning:
        report.warnings.append(index.warning)
    if findings.broken:
        report.warnings.append(
            f"{findings.broken} of {findings.rows} rows of the index cannot be read; the first: "
            f"{findings.first_fault}"
        )
    if index.layout is not None and index.layout.rows not in {None, findings.rows}:
        report.warnings.append(
            f"the index has {findings.rows} rows, but {index.layout.rows} by its label"
        )
    if not findings.pairs:
        report.failures.append(
            f"the index of {index.volume.name} has no stereo pair of {selection.instrument} on "
            f"sols {min(selection.sols)} to {max(selection.sols)}"
        )


def _list(
    paths: Sequence[Path], are_here: Sequence[bool], out_dir: Path, report: FetchReport
) -> None:
    for path, here in zip(paths, are_here, strict=True):
        report.already_here += here
        report.files.append(f"{path.relative_to(out_dir)}{'  (here)' if here else ''}")


@contextmanager
def _exclusive(out_dir: Path) -> Iterator[None]:
    """Keep a second fetch out of the folder: both would write the same files."""
    lock = out_dir / STATE / "lock"
    try:
        lock.parent.mkdir(parents=True, exist_ok=True)
        file = lock.open("w")
    except OSError as error:
        raise FetchError(f"{out_dir} cannot be written: {error.strerror}") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise FetchError(
                f"another fetch is writing to {out_dir}; wait until it ends"
            ) from error
        yield
