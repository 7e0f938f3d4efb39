"""The images of a selection, several at a time; complete ones are not fetched again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from solmap.photogrammetry.archive.images.reading import read_label
from solmap.photogrammetry.archive.labels.label import MAX_LABEL_BYTES
from solmap.photogrammetry.archive.tables.volume_index import IndexEntry
from solmap.photogrammetry.errors import LabelError
from solmap.products.store.user_files import open_user_file
from solmap.tasks.fetch.answers import DiskError, FetchError, WrongContentError
from solmap.tasks.fetch.index import Volume, local_name
from solmap.tasks.fetch.partial import PartialFile
from solmap.tasks.fetch.transfer import Transfer
from solmap.tasks.stage import stage


@dataclass(frozen=True, slots=True)
class Arrival:
    """Result of fetching one image."""

    path: Path
    received_bytes: int = 0
    was_here: bool = False
    failure: str = ""


@stage(task_run_name="images-{volume.name}", makes_products=False)
def fetch_images(
    entries: Sequence[IndexEntry],
    volume: Volume,
    out_dir: Path,
    transfer: Transfer,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[Arrival]:
    """Fetch images, each into the folder of its sol; a failure does not stop the others.

    Raises:
        DiskError: the disk is full, so that nothing else can be written.
    """
    pool = ThreadPoolExecutor(transfer.params.connections)
    try:
        futures = [pool.submit(_fetch, entry, volume, out_dir, transfer) for entry in entries]
        for done, future in enumerate(as_completed(futures), 1):
            future.result()  # a full disk stops the others
            progress(done, len(futures))
        return [future.result() for future in futures]
    finally:
        pool.shutdown(cancel_futures=True)


def target_of(entry: IndexEntry, out_dir: Path) -> Path:
    """Local path of an image."""
    return out_dir / f"sol{entry.sol:04d}" / local_name(entry)


def is_whole(path: Path) -> bool:
    """Whether an image exists with the size in its label."""
    try:
        check_image(path)
    except (WrongContentError, FileNotFoundError):
        return False
    except OSError as error:
        raise DiskError(f"{path} cannot be read: {error.strerror or error}") from error
    return True


def check_image(path: Path) -> None:
    """Compare the size of a file with RECORD_BYTES x FILE_RECORDS of its attached label.

    Raises:
        WrongContentError: it is not an image, or of another size.
    """
    name = path.name.removesuffix(".part")
    with open_user_file(path) as file:
        beginning = file.read(MAX_LABEL_BYTES)
    try:
        label = read_label(beginning, name)
        record_bytes = label.require("", "RECORD_BYTES", int)
        records = label.require("", "FILE_RECORDS", int)
    except LabelError as error:
        raise WrongContentError(str(error)) from error
    size = path.stat().st_size
    if size != record_bytes * records:
        raise WrongContentError(
            f"{name} has {size} bytes, but its label has {records} records of {record_bytes} "
            f"bytes, {record_bytes * records}"
        )


def _fetch(entry: IndexEntry, volume: Volume, out_dir: Path, transfer: Transfer) -> Arrival:
    path = target_of(entry, out_dir)
    if is_whole(path):
        return Arrival(path, was_here=True)
    try:
        if path.exists():
            path.unlink()  # damaged locally, so "not modified" must not be accepted
        fetched = transfer.fetch(volume.image_urls(entry), path, check_image)
        PartialFile(path).forget()
    except DiskError:
        raise
    except FetchError as error:
        return Arrival(path, failure=str(error))
    except OSError as error:
        raise DiskError(f"{path} cannot be written: {error.strerror or error}") from error
    return Arrival(path, fetched.received_bytes)
