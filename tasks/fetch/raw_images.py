"""Public raw images of Curiosity and Perseverance: the lists of mars.nasa.gov and their images.

The lists answer in pages of JSON, `items` of `api/v1/raw_image_items` (MSL) and `images` of
`rss/api` (Mars 2020). An image's item is stored beside its file as X.json, which ingestion reads as
its label; `photogrammetry.archive.images.json_metadata` documents its content. Stereo pairs are
found in the items as in labels. Thumbnails are left out, and so are images without camera model or
attitude.

Addresses of images come over the network, so only those on the archive file's hosts are used.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote, urlencode, urlsplit

from solmap.photogrammetry.archive.images.json_metadata import rover_image_of_metadata
from solmap.photogrammetry.archive.images.pixels import image_file_size, is_image_file
from solmap.photogrammetry.archive.missions import mission_of_host
from solmap.photogrammetry.archive.partners import find_stereo_pairs
from solmap.photogrammetry.archive.tables.volume_index import IndexSelection
from solmap.photogrammetry.errors import LabelError, PixelError
from solmap.photogrammetry.imagery import RoverImage
from solmap.tasks.fetch.answers import DiskError, FetchError, WrongContentError
from solmap.tasks.fetch.images import Arrival
from solmap.tasks.fetch.partial import PartialFile
from solmap.tasks.fetch.transfer import Transfer
from solmap.tasks.stage import stage

PAGE = 100
"""Images per page: the most that the lists return."""
MAX_PAGES = 2_000
LISTS = {"MSL": "items", "M20": "images"}
"""Mission -> key of a page's images."""
_PLAIN = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]*\.(?:png|jpe?g)\Z", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class RawImage:
    """An image of a list."""

    record: RoverImage
    url: str
    name: str
    """Name of its file."""
    item: dict[str, Any]

    def path(self, out_dir: Path) -> Path:
        """Local path of its file."""
        return out_dir / f"sol{self.record.sol:04d}" / self.name


@dataclass(frozen=True, slots=True)
class RawFindings:
    """Images of a selection in a list."""

    images: tuple[RawImage, ...]
    """The images of all pairs, left before right."""
    unpaired: int
    left_out: int
    """Images without a known pose."""
    first_fault: str = ""


@stage(task_run_name="raw-list-{selection.mission}", makes_products=False)
def find_raw_images(
    url: str, selection: IndexSelection, folder: Path, transfer: Transfer
) -> RawFindings:
    """The stereo pairs among the public raw images of a selection.

    Args:
        url: the address of the list, without a query.
        selection: mission (MSL, M20), instrument, sols.
        folder: where the pages of the list are stored.
        transfer: to fetch them with.

    Raises:
        FetchError: the list is not available, or is not a list.
    """
    images: dict[str, RawImage] = {}
    left_out, first_fault = 0, ""
    for item in _items(url, selection, folder, transfer):
        try:
            image = _raw_image(item, selection, transfer.hosts)
        except LabelError as error:
            left_out += 1
            first_fault = first_fault or str(error)
            continue
        if image is not None:
            images[image.record.id] = image
    pairing = find_stereo_pairs([image.record for image in images.values()])
    paired = [images[one.id] for pair in pairing.pairs for one in (pair.left, pair.right)]
    return RawFindings(tuple(paired), len(images) - len(paired), left_out, first_fault)


@stage(task_run_name="raw-images", makes_products=False)
def fetch_raw_images(
    images: tuple[RawImage, ...],
    out_dir: Path,
    transfer: Transfer,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[Arrival]:
    """Fetch images and their metadata, each into the folder of its sol.

    Raises:
        DiskError: the disk is full, so that nothing else can be written.
    """
    pool = ThreadPoolExecutor(transfer.params.connections)
    try:
        futures = [pool.submit(_fetch, image, out_dir, transfer) for image in images]
        for done, future in enumerate(as_completed(futures), 1):
            future.result()  # a full disk stops the others
            progress(done, len(futures))
        return [future.result() for future in futures]
    finally:
        pool.shutdown(cancel_futures=True)


def is_raw_image_here(image: RawImage, out_dir: Path) -> bool:
    """Whether image and metadata exist and are complete."""
    path = image.path(out_dir)
    try:
        _check_image_file(path, image.record)
        return path.with_suffix(".json").is_file()
    except (WrongContentError, FileNotFoundError):
        return False


def _items(
    url: str, selection: IndexSelection, folder: Path, transfer: Transfer
) -> Iterator[dict[str, Any]]:
    """The items of a list, page after page."""
    key = LISTS.get(selection.mission)
    mission = mission_of_host(selection.mission)
    if key is None or mission is None:
        raise FetchError(
            f"there is no public list of raw images of {selection.mission}; leave out --raw"
        )
    cameras = [name for name, (kind, _) in mission.instruments.items() if selection.admits(kind)]
    for number in range(MAX_PAGES):
        page = folder / f"{selection.instrument.lower()}-{number}.json"
        query = _query(selection, cameras, number)
        transfer.fetch([f"{url}?{query}"], page, lambda path: _check_page(path, key))
        answer = json.loads(page.read_bytes())
        yield from (item for item in answer[key] if isinstance(item, dict))
        if len(answer[key]) < PAGE or answer.get("more") is False:
            return


def _query(selection: IndexSelection, cameras: list[str], page: int) -> str:
    sols = {
        "condition_2": f"{min(selection.sols)}:sol:gte",
        "condition_3": f"{max(selection.sols)}:sol:lte",
        "search": "|".join(cameras),
        "page": page,
    }
    if selection.mission == "MSL":
        query = {
            "order": "sol asc,instrument_sort asc,sample_type_sort asc,date_taken asc",
            "per_page": PAGE,
            "condition_1": "msl:mission",
            "extended": "thumbnail::sample_type::noteq",
        }
    else:
        query = {
            "feed": "raw_images",
            "category": "mars2020",
            "feedtype": "json",
            "ver": "1.2",
            "num": PAGE,
            "order": "sol asc",
            "extended": "sample_type::full,",
        }
    # these servers do not read a plus as a blank
    return urlencode({**query, **sols}, quote_via=quote)


def _check_page(path: Path, key: str) -> None:
    try:
        answer = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise WrongContentError(
            f"the list of raw images is not JSON: {str(error)[:100]}"
        ) from error
    if not isinstance(answer, dict) or not isinstance(answer.get(key), list):
        raise WrongContentError(f"the list of raw images has no {key!r}")


def _raw_image(
    item: dict[str, Any], selection: IndexSelection, hosts: frozenset[str]
) -> RawImage | None:
    """The image of an item; None where not selected.

    Raises:
        LabelError: it is selected, but has no known pose or cannot be fetched.
    """
    camera = item.get("camera")
    instrument = str((camera if isinstance(camera, dict) else item).get("instrument")).upper()
    mission = mission_of_host(selection.mission)
    known = mission.instruments.get(instrument) if mission else None
    is_thumbnail = item.get("is_thumbnail") is True or (
        str(item.get("sample_type")).upper() == "THUMBNAIL"
    )
    if known is None or not selection.admits(known[0]) or is_thumbnail:
        return None
    if item.get("sol") not in selection.sols:
        return None
    files = item.get("image_files")
    url = str(
        files.get("full_res")
        if isinstance(files, dict)
        else item.get("https_url") or item.get("url")
    )
    name = unquote(urlsplit(url).path).rpartition("/")[2]
    if urlsplit(url).hostname not in hosts or not _PLAIN.match(name):
        raise LabelError(
            f"{str(item.get('imageid'))[:60]!a}: its file should be on a host of the archive's "
            f"file, under a plain name, but is at {url[:100]!a}"
        )
    return RawImage(rover_image_of_metadata(json.dumps(item), name), url, name, item)


def _fetch(image: RawImage, out_dir: Path, transfer: Transfer) -> Arrival:
    path = image.path(out_dir)
    if is_raw_image_here(image, out_dir):
        return Arrival(path, was_here=True)
    try:
        fetched = transfer.fetch(
            [image.url], path, lambda file: _check_image_file(file, image.record)
        )
        PartialFile(path).forget()
        path.with_suffix(".json").write_text(json.dumps(image.item, indent=1))
    except DiskError:
        raise
    except FetchError as error:
        return Arrival(path, failure=str(error))
    except OSError as error:
        raise DiskError(f"{path} cannot be written: {error.strerror or error}") from error
    return Arrival(path, fetched.received_bytes)


def _check_image_file(path: Path, record: RoverImage) -> None:
    """Reject what is not an image, or has another size than its metadata."""
    data = path.read_bytes()
    name = path.name.removesuffix(".part")
    try:
        size = image_file_size(data, name) if is_image_file(data) else None
    except PixelError as error:
        raise WrongContentError(str(error)) from error
    if size != (record.samples, record.lines):
        found = f"of {size[0]} x {size[1]} pixels" if size else "no picture"
        raise WrongContentError(
            f"{name} is {found}, its metadata have {record.samples} x {record.lines} pixels"
        )
