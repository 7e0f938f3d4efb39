"""Stereo pairs come from an archive over HTTP, despite faults of network and server.

The archive is a real server with the real layout: folders, index tables, ranges, validators. Faults
are put into it one by one, and its log of requests is compared.
"""

import json
import re
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner

from solmap.config.archive import load_archive
from solmap.config.records import ConfigError
from solmap.flows.runtime.progress import Step, listen
from solmap.photogrammetry.archive.file_names import parse_file_name
from solmap.photogrammetry.synthetic.scene import WorldParams
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from tests.support.small_downlink import rendered_images

VOLUME = "/mer2no_0xxx"
TABLE, LABEL = f"{VOLUME}/index/edrindex.tab", f"{VOLUME}/index/edrindex.lbl"
ROW_BYTES = 933
COLUMNS = (
    # name, width, quoted; the first eight lie where the archive's label puts them
    ("VOLUME_ID", 11, True),
    ("DATA_SET_ID", 40, True),
    ("INSTRUMENT_HOST_ID", 4, True),
    ("INSTRUMENT_ID", 18, True),
    ("PATH_NAME", 65, True),
    ("FILE_NAME", 32, True),
    ("RELEASE_ID", 4, True),
    ("PRODUCT_ID", 27, True),
    ("PLANET_DAY_NUMBER", 4, False),
    ("SPACECRAFT_CLOCK_START_COUNT", 30, True),
    ("SEQUENCE_ID", 30, True),
    ("IMAGE_TYPE", 10, True),
    ("TELEMETRY_SOURCE_NAME", 586, True),
    ("ROVER_MOTION_COUNTER", 34, False),
)


def index_label(rows: int) -> bytes:
    lines = ["PDS_VERSION_ID = PDS3", "OBJECT = EDR_INDEX_TABLE", f"  ROWS = {rows}"]
    lines.append(f"  ROW_BYTES = {ROW_BYTES}")
    start = 1
    for name, width, quoted in COLUMNS:
        lines += ["  OBJECT = COLUMN", f"    NAME = {name}", f"    START_BYTE = {start + quoted}"]
        lines.append(f"    BYTES = {width}")
        if name == "ROVER_MOTION_COUNTER":
            lines += ["    ITEMS = 5", "    ITEM_BYTES = 6", "    ITEM_OFFSET = 7"]
        lines += [f'    DESCRIPTION = "{name}"', "  END_OBJECT = COLUMN"]
        start += width + 2 * quoted + 1
    assert start - 1 == ROW_BYTES
    return "\r\n".join([*lines, "END_OBJECT = EDR_INDEX_TABLE", "END", ""]).encode()


def index_row(file_name: str, sol: int, **changes: str) -> bytes:
    name = parse_file_name(file_name)
    values = {
        "VOLUME_ID": VOLUME[1:],
        "DATA_SET_ID": "MER2-M-NAVCAM-2-EDR-OPS-V1.0",
        "INSTRUMENT_HOST_ID": "MER2",
        "INSTRUMENT_ID": f"NAVCAM_{'LEFT' if name.eye == 'L' else 'RIGHT'}",
        "PATH_NAME": f"{VOLUME[1:]}/data/sol{sol:04d}/edr/",
        "FILE_NAME": file_name,
        "PRODUCT_ID": name.product_id,
        "PLANET_DAY_NUMBER": str(sol),
        "SPACECRAFT_CLOCK_START_COUNT": f"{name.clock}.496",
        "SEQUENCE_ID": name.sequence,
        "IMAGE_TYPE": "REGULAR",
        "ROVER_MOTION_COUNTER": "\t".join(f"{count:<6}" for count in (name.site, 0, 0, 5, 2)),
        **changes,
    }
    fields = [(f"{values.get(column, '0'):<{width}}", quoted) for column, width, quoted in COLUMNS]
    row = "\t".join(f'"{text}"' if quoted else text for text, quoted in fields) + "\n"
    assert len(row) == ROW_BYTES
    return row.encode()


@dataclass
class Request:
    path: str
    range: str | None
    if_range: str | None
    sent: int = 0


@dataclass
class Served:
    """What lies under an address: bytes, or a table made while it is sent."""

    size: int
    bytes_from: Callable[[int], Iterator[bytes]]
    tag: str | None = '"1"'


@dataclass
class ArchiveServer:
    """A web server with the archive's tree, and faults for the next answers to an address."""

    files: dict[str, Served] = field(default_factory=dict)
    faults: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))
    requests: list[Request] = field(default_factory=list)
    with_ranges: bool = True
    url: str = ""

    def put(self, path: str, data: bytes, tag: str | None = '"1"') -> None:
        self.files[path] = Served(len(data), lambda start: iter([data[start:]]), tag)

    def requested(self, path: str) -> list[Request]:
        return [request for request in self.requests if request.path == path]

    def answer(self, handler: BaseHTTPRequestHandler) -> None:
        request = Request(handler.path, handler.headers["Range"], handler.headers["If-Range"])
        self.requests.append(request)
        faults = self.faults[handler.path]
        fault = faults.pop(0) if faults else None
        match fault, self.files.get(handler.path):
            case (int(status), _) if status >= 400:
                self.refuse(handler, status)
            case (str(address), _):
                handler.send_response(302)
                handler.send_header("Location", address)
                handler.send_header("Content-Length", "0")
                handler.end_headers()
            case (_, None):
                self.refuse(handler, 404)
            case (_, served):
                self.send(handler, request, served, fault)

    def refuse(self, handler: BaseHTTPRequestHandler, status: int) -> None:
        handler.send_response(status)
        handler.send_header("Content-Length", "5")
        handler.send_header("Retry-After", "7")
        handler.end_headers()
        handler.wfile.write(b"sorry")

    def send(self, handler, request: Request, served: Served, fault: object) -> None:
        unless = handler.headers["If-None-Match"] or handler.headers["If-Modified-Since"]
        if served.tag and unless == served.tag:
            handler.send_response(304)
            handler.end_headers()
            return
        start = 0
        is_same = request.if_range in {None, served.tag}
        if request.range and self.with_ranges and is_same:
            start = int(re.fullmatch(r"bytes=(\d+)-", request.range)[1])
        if start >= served.size:
            handler.send_response(416)
            handler.send_header("Content-Range", f"bytes */{served.size}")
            handler.send_header("Content-Length", "5")
            handler.end_headers()
            handler.wfile.write(b"sorry")
            return
        handler.send_response(206 if start else 200)
        if start:
            span = f"bytes {start}-{served.size - 1}/{served.size}"
            handler.send_header("Content-Range", span)
        if not isinstance(fault, dict) or fault.get("with_length", True):
            handler.send_header("Content-Length", str(served.size - start))
        if served.tag:
            name = "ETag" if served.tag.endswith('"') else "Last-Modified"
            handler.send_header(name, served.tag)
        if isinstance(fault, dict) and "coding" in fault:
            handler.send_header("Content-Encoding", fault["coding"])
        handler.end_headers()
        left = fault.get("cut", served.size) if isinstance(fault, dict) else served.size
        for data in served.bytes_from(start):
            handler.wfile.write(data[:left])
            request.sent += len(data[:left])
            left -= len(data[:left])
            if left <= 0:
                break
        handler.close_connection = isinstance(fault, dict)  # else the next request would be cut


@pytest.fixture
def servers(monkeypatch) -> Iterator[Callable[[], ArchiveServer]]:
    """Starts archive servers on this machine."""
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    running = []

    def start() -> ArchiveServer:
        archive = ArchiveServer()

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self):
                archive.answer(self)

            def log_message(self, *_args):
                pass

        server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        server.daemon_threads = True
        server.handle_error = lambda *_args: None  # a client that disconnects early does no harm
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        running.append((server, thread))
        archive.url = f"http://127.0.0.1:{server.server_port}"
        return archive

    yield start
    for server, thread in running:
        server.shutdown()
        server.server_close()
        thread.join()


@pytest.fixture(scope="module")
def images() -> dict[str, bytes]:
    """Address -> bytes of three stereo pairs of a synthetic world, on sol 155."""
    params = WorldParams("plains", TraverseParams(stops=1), pairs=3, averaging=4)
    return {f"{VOLUME}/data/{file.path}": file.data for file in rendered_images(params, 5)}


@pytest.fixture
def archive(servers, images) -> ArchiveServer:
    return stocked(servers(), images)


def stocked(archive: ArchiveServer, images: dict[str, bytes]) -> ArchiveServer:
    rows = [index_row(Path(path).name, 155) for path in images]
    archive.put(TABLE, b"".join(rows), '"table"')
    archive.put(LABEL, index_label(len(rows)), '"label"')
    for path, data in images.items():
        archive.put(path, data, f'"{len(data)}-{Path(path).stem}"')
    return archive


@dataclass
class Fetcher:
    """Calls the flow's function with a list of mirrors; its tasks run without the engine."""

    folder: Path
    waits: list[float]

    def __call__(self, *archives: ArchiveServer, sols: str = "155-157", **options: Any):
        from solmap.flows.fetch import fetch_archive  # noqa: PLC0415 - slow to import

        hosts = options.pop("redirect_hosts", ())
        file = self.settings(*archives, redirect_hosts=hosts)
        out = options.pop("out", self.folder / "out")
        return fetch_archive.fn("MER2", sols, ["navcam"], out, archive_file=file, **options)

    def settings(self, *archives: ArchiveServer, redirect_hosts: tuple[str, ...] = ()) -> Path:
        file = self.folder / "archive.toml"
        file.write_text(
            f"redirect_hosts = {json.dumps(redirect_hosts)}\n"
            "[transfer]\nconnections = 2\nattempts = 3\nfirst_wait_s = 0.01\ntimeout_s = 5.0\n"
            f'[missions.MER2]\ntitle = "Spirit"\n'
            f"base_urls = {json.dumps([archive.url for archive in archives])}\n"
            f'volumes = {{ navcam = "{VOLUME[1:]}" }}\n'
        )
        return file


@pytest.fixture
def fetch(tmp_path, monkeypatch) -> Fetcher:
    from solmap.flows import fetch as flow  # noqa: PLC0415 - slow to import
    from solmap.tasks.fetch import transfer  # noqa: PLC0415

    for task in ("fetch_index", "fetch_images"):
        monkeypatch.setattr(flow, task, getattr(flow, task).fn)
    waits: list[float] = []
    monkeypatch.setattr(transfer.Transfer.__init__, "__defaults__", (waits.append,))
    return Fetcher(tmp_path, waits)


def here(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and ".fetch" not in path.parts
    }


def queried(images: dict[str, bytes]) -> dict[str, bytes]:
    return {f"sol0155/{Path(path).name}": data for path, data in images.items()}


def test_the_pairs_of_a_sol_arrive_byte_for_byte(archive, images, fetch):
    steps: list[Step] = []
    with listen(steps.append):
        report = fetch(archive)
    assert report.succeeded
    assert (report.pairs, report.fetched, report.already_here) == (3, 6, 0)
    assert here(fetch.folder / "out") == queried(images)
    assert steps[0] == Step("index of mer2no_0xxx, MiB", 1, 1)
    assert steps[-1] == Step("navcam images", 6, 6)


def test_a_second_run_requests_no_image_and_revalidates_the_index(archive, images, fetch):
    fetch(archive)
    archive.requests.clear()
    report = fetch(archive)
    assert report.succeeded
    assert (report.fetched, report.already_here, report.received_bytes) == (0, 6, 0)
    assert [request.path for request in archive.requests] == [LABEL, TABLE]
    assert sum(request.sent for request in archive.requests) == 0
    assert here(fetch.folder / "out") == queried(images)


def test_an_index_that_has_changed_is_fetched_again(archive, images, fetch):
    fetch(archive)
    first, second, *_ = images
    rows = [index_row(Path(path).name, 155) for path in (first, second)]
    archive.put(TABLE, b"".join(rows), '"newer"')
    report = fetch(archive)
    assert report.pairs == 1
    assert report.warnings == ["the index has 2 rows, but 6 by its label"]


def test_an_interrupted_transfer_resumes_at_its_last_byte(archive, images, fetch):
    path = next(iter(images))
    archive.faults[path] = [{"cut": 70_000}, {"cut": 50_000}]
    report = fetch(archive)
    assert report.succeeded
    assert here(fetch.folder / "out") == queried(images)
    requested = archive.requested(path)
    size = len(images[path])
    assert requested[0].range is None
    starts = [int(re.search(r"\d+", request.range)[0]) for request in requested[1:]]
    assert len(starts) == 2
    assert starts[0] <= 70_000 < starts[1] <= 120_000
    assert requested[-1].sent == size - starts[1]
    assert all(request.if_range == archive.files[path].tag for request in requested[1:])


def test_a_file_that_changed_between_attempts_is_fetched_from_its_beginning(archive, images, fetch):
    path = next(iter(images))
    data = images[path]
    archive.put(path, b"x" * 40_000 + data[40_000:], '"old"')
    archive.faults[path] = [{"cut": 60_000}, 500, 500]
    assert not fetch(archive).succeeded
    archive.put(path, data, '"new"')
    assert fetch(archive).succeeded
    assert archive.requested(path)[-1].range is not None
    assert here(fetch.folder / "out") == queried(images)


def test_a_server_without_ranges_is_requested_for_the_whole_file(archive, images, fetch):
    path = next(iter(images))
    archive.with_ranges = False
    archive.faults[path] = [{"cut": 70_000}]
    assert fetch(archive).succeeded
    assert [request.sent for request in archive.requested(path)] == [70_000, len(images[path])]
    assert here(fetch.folder / "out") == queried(images)


def test_a_server_without_validators_is_trusted_if_lengths_agree(archive, images, fetch):
    path = next(iter(images))
    archive.put(path, images[path], tag=None)
    archive.faults[path] = [{"cut": 70_000}]
    assert fetch(archive).succeeded
    assert archive.requested(path)[-1].range is not None
    assert here(fetch.folder / "out") == queried(images)


def test_a_complete_draft_is_renamed_without_a_transfer(archive, images, fetch):
    """A process may be killed between the last byte and the new name."""
    path = next(iter(images))
    archive.faults[path] = [{"cut": len(images[path]) - 1}, 500, 500]
    fetch(archive)
    (part,) = fetch.folder.rglob("*.img.part")
    part.write_bytes(images[path])
    archive.requests.clear()
    assert fetch(archive).succeeded
    assert [request.sent for request in archive.requested(path)] == [0]
    assert here(fetch.folder / "out") == queried(images)


def test_unreadable_resume_notes_restart_the_transfer(archive, images, fetch):
    path = next(iter(images))
    archive.faults[path] = [{"cut": 70_000}, 500, 500]
    fetch(archive)
    (notes,) = (fetch.folder / "out" / "sol0155").glob("*.source")
    notes.write_text('{"url": 1, "colour": "red"}')
    assert fetch(archive).succeeded
    assert archive.requested(path)[-1].range is None
    assert here(fetch.folder / "out") == queried(images)


def test_a_date_is_the_validator_if_there_is_no_tag(archive, images, fetch):
    path, date = next(iter(images)), "Sat, 05 Jun 2004 06:54:46 GMT"
    archive.put(path, images[path], date)
    archive.put(TABLE, b"".join(archive.files[TABLE].bytes_from(0)), date)
    archive.faults[path] = [{"cut": 70_000}]
    assert fetch(archive).succeeded
    assert archive.requested(path)[-1].if_range == date
    archive.requests.clear()
    assert fetch(archive).already_here == 6
    assert sum(request.sent for request in archive.requests) == 0


def test_parts_with_a_weak_tag_are_not_joined(archive, images, fetch):
    path = next(iter(images))
    archive.put(path, images[path], 'W/"1"')
    archive.faults[path] = [{"cut": 70_000}]
    assert fetch(archive).succeeded
    assert archive.requested(path)[-1].if_range is None  # the lengths agree, and that must do
    assert here(fetch.folder / "out") == queried(images)


def test_parts_of_files_of_two_lengths_are_not_joined(archive, images, fetch):
    path = next(iter(images))
    archive.put(path, b"x" * 140_000, tag=None)
    archive.faults[path] = [{"cut": 70_000}, 500, 500]
    assert not fetch(archive).succeeded
    archive.put(path, images[path], tag=None)
    assert fetch(archive).succeeded
    assert [request.range for request in archive.requested(path)][-2:] == ["bytes=70000-", None]
    assert here(fetch.folder / "out") == queried(images)


def test_a_file_with_content_encoding_is_refused(archive, images, fetch):
    path = next(iter(images))
    archive.faults[path] = [{"coding": "gzip"}]
    (line,) = fetch(archive).failures
    assert line.endswith("127.0.0.1 sends the file gzip-coded, although no coding was requested")


def test_concurrent_transfers_equal_the_number_of_connections(archive, images, fetch):
    """The first two wait for each other, so one at a time would never end."""
    both, busy, most = threading.Barrier(2, timeout=20), set(), []

    def together(path):
        def chunks(start):
            busy.add(path)
            if path in first:
                both.wait()
            most.append(len(busy))
            time.sleep(0.02)
            busy.discard(path)
            yield images[path][start:]

        return chunks

    first = list(images)[:2]
    for path, data in images.items():
        archive.files[path] = Served(len(data), together(path), None)
    assert fetch(archive).fetched == 6
    assert max(most) == 2


def test_no_redirect_leads_from_https_to_http():
    from solmap.tasks.fetch.answers import NextMirrorError, _redirect_target  # noqa: PLC0415

    def redirected(location):
        request = httpx.Request("GET", "https://a.example/x.img")
        response = httpx.Response(302, headers={"Location": location}, request=request)
        return _redirect_target(response, frozenset({"a.example", "b.example"}))

    assert redirected("https://b.example/y.img") == "https://b.example/y.img"
    assert redirected("/z.img") == "https://a.example/z.img"
    with pytest.raises(NextMirrorError, match="from https to http"):
        redirected("http://b.example/y.img")


def test_a_truncation_without_length_is_detected_by_the_label(archive, images, fetch):
    path = next(iter(images))

    archive.faults[path] = [{"cut": 80_000, "with_length": False}]
    assert fetch(archive).succeeded
    assert here(fetch.folder / "out") == queried(images)


def test_a_missing_file_is_named_and_the_others_arrive(archive, images, fetch):
    path = list(images)[3]
    del archive.files[path]
    report = fetch(archive)
    assert not report.succeeded
    assert report.fetched == 5
    (line,) = report.failures
    name = Path(path).name
    assert line == f"{name}: 127.0.0.1 answers 404 Not Found for {path}"
    assert len(archive.requested(path)) == 1
    assert set(queried(images)) - set(here(fetch.folder / "out")) == {f"sol0155/{name}"}


def test_a_failing_server_is_retried_with_growing_waits(archive, images, fetch):
    path = next(iter(images))
    archive.faults[path] = [503, 500]
    assert fetch(archive).succeeded
    assert fetch.waits == [7.0, 7.0]  # as in Retry-After, which is longer than 0.01 and 0.02 s


def test_a_server_that_keeps_failing_is_given_up(archive, images, fetch):
    path = next(iter(images))
    archive.faults[path] = [500] * 10
    report = fetch(archive)
    assert report.failures == [
        f"{Path(path).name}: 127.0.0.1 answers 500 Internal Server Error for {path}"
    ]
    assert len(archive.requested(path)) == 3


def test_a_file_missing_on_one_mirror_is_fetched_from_the_next(servers, images, fetch):
    first, second = stocked(servers(), images), stocked(servers(), images)
    path = list(images)[2]
    del first.files[path]
    assert fetch(first, second).succeeded
    assert [request.path for request in second.requests] == [path]
    assert here(fetch.folder / "out") == queried(images)


def test_an_unreachable_mirror_is_not_tried_for_every_file(servers, images, fetch):
    gone, alive = ArchiveServer(url="http://127.0.0.1:9"), stocked(servers(), images)
    assert fetch(gone, alive).succeeded
    assert len(fetch.waits) == 2  # of the index's label alone
    assert here(fetch.folder / "out") == queried(images)


def test_without_any_mirror_the_kept_index_is_used(archive, images, fetch):
    fetch(archive)
    lost = fetch.folder / "out" / "sol0155" / Path(next(iter(images))).name
    lost.unlink()
    report = fetch(ArchiveServer(url="http://127.0.0.1:9"))
    assert len(fetch.waits) == 2  # a missing mirror gets no request for the image
    (warning,) = report.warnings
    assert warning.startswith("an earlier copy of the index is used: edrindex.lbl: 127.0.0.1 ")
    (failure,) = report.failures
    assert "cannot be reached" in failure
    assert report.already_here == 5


def test_a_redirect_to_a_listed_host_is_followed(archive, servers, images, fetch):
    path = next(iter(images))
    moved = stocked(servers(), images)
    archive.faults[path] = [moved.url + path]
    assert fetch(archive).succeeded
    assert [request.path for request in moved.requests] == [path]
    assert here(fetch.folder / "out") == queried(images)


@pytest.mark.parametrize(
    "address", ["http://localhost:{port}/x.img", "file:///etc/passwd", "http://["]
)
def test_a_redirect_to_anywhere_else_is_refused(archive, servers, images, fetch, address):
    path = next(iter(images))
    other = servers()
    archive.faults[path] = [address.format(port=other.url.rpartition(":")[2])]
    (line,) = fetch(archive).failures
    assert line.startswith(f"{Path(path).name}: 127.0.0.1 redirects to ")
    assert not other.requests


def test_a_host_may_be_listed_for_redirects_alone(archive, servers, images, fetch):
    path = next(iter(images))
    moved = stocked(servers(), images)
    archive.faults[path] = [moved.url.replace("127.0.0.1", "localhost") + path]
    assert fetch(archive, redirect_hosts=("localhost",)).succeeded
    assert [request.path for request in moved.requests] == [path]


def test_redirects_in_a_circle_end(archive, images, fetch):
    path = next(iter(images))
    archive.faults[path] = [archive.url + path] * 20
    (line,) = fetch(archive).failures
    assert line.endswith("127.0.0.1 redirects more than 5 times")


def test_a_file_whose_size_contradicts_its_label_is_refused(archive, images, fetch):
    path = next(iter(images))
    archive.put(path, images[path] + b"more")
    (line,) = fetch(archive).failures
    size = len(images[path])
    assert f"has {size + 4} bytes, but its label has" in line
    assert line.endswith(f", {size}")
    assert not list(fetch.folder.rglob("*.part"))
    assert len(here(fetch.folder / "out")) == 5


def test_an_html_page_instead_of_an_image_is_refused(archive, images, fetch):
    path = next(iter(images))
    archive.put(path, b"<html>This archive has moved</html>")
    (line,) = fetch(archive).failures
    assert "not a PDS3 image: it starts with '<html>This" in line


def test_an_html_page_instead_of_the_index_is_refused(archive, fetch):
    from solmap.tasks.fetch.answers import FetchError  # noqa: PLC0415 - slow to import

    archive.put(TABLE, b"<html>\n<body>This archive has moved</body>\n</html>\n")
    with pytest.raises(FetchError, match=r"edrindex.tab: .*row 1 should be 933 bytes wide"):
        fetch(archive)


def test_an_image_damaged_on_disk_is_fetched_again(archive, images, fetch):
    fetch(archive)
    address, path = next(iter(images)), fetch.folder / "out" / next(iter(queried(images)))
    path.write_bytes(path.read_bytes()[:1000])
    source = {"url": archive.url + address, "validator": archive.files[address].tag}
    path.with_name(path.name + ".source").write_text(json.dumps(source))  # unchanged over there
    archive.requests.clear()
    assert fetch(archive).fetched == 1
    assert here(fetch.folder / "out") == queried(images)


def test_names_from_the_index_cannot_leave_the_folder(archive, images, fetch):
    names = [Path(path).name for path in images]
    rows = [
        *(index_row(name, 155, PATH_NAME="../../etc/") for name in names[:2]),
        *(index_row(name, 155, FILE_NAME=f"/{name}") for name in names[2:4]),
        *(index_row(name, 155) for name in names[4:]),
    ]
    archive.put(TABLE, b"".join(rows))
    report = fetch(archive)
    assert report.fetched == 2
    assert len(report.failures) == 4
    assert all("should give a plain folder and file name" in line for line in report.failures)
    assert not any(".." in request.path for request in archive.requests)


def test_an_upper_case_index_finds_lower_case_files(archive, images, fetch):
    rows = [
        index_row(Path(path).name.upper(), 155, PATH_NAME="/DATA/SOL0155/EDR") for path in images
    ]
    archive.put(TABLE, b"".join(rows))
    assert fetch(archive).succeeded
    assert here(fetch.folder / "out") == queried(images)


def test_a_dry_run_lists_and_fetches_no_image(archive, images, fetch):
    name = next(iter(queried(images)))
    there = fetch.folder / "out" / name
    there.parent.mkdir(parents=True)
    there.write_bytes(queried(images)[name])
    report = fetch(archive, dry_run=True)
    assert [request.path for request in archive.requests] == [LABEL, TABLE]
    text = "\n".join(report.lines)
    assert f"{name}  (here)" in text
    assert text.endswith("3 stereo pairs (0 images have no partner); 1 images were here already")
    assert all(line in text for line in queried(images))


def test_sols_without_a_pair_are_a_failure(archive, fetch):
    report = fetch(archive, sols="156-157")
    assert report.failures == [
        "the index of mer2no_0xxx has no stereo pair of navcam on sols 156 to 157"
    ]


def test_two_fetches_do_not_write_to_one_folder_at_a_time(archive, fetch):
    from solmap.flows.fetch import _exclusive  # noqa: PLC0415 - slow to import
    from solmap.tasks.fetch.answers import FetchError  # noqa: PLC0415

    with (
        _exclusive(fetch.folder / "out"),
        pytest.raises(FetchError, match="another fetch is writing to"),
    ):
        fetch(archive)


def test_an_unwritable_folder_ends_the_run_with_one_line(archive, images, fetch):
    from solmap.tasks.fetch.answers import FetchError  # noqa: PLC0415 - slow to import

    name = next(iter(queried(images)))
    (fetch.folder / "out" / f"{name}.part").mkdir(parents=True)
    with pytest.raises(FetchError, match=rf"{name} cannot be written: Is a directory"):
        fetch(archive)


@pytest.mark.parametrize("sols", ["", "x", "157-155", "155-", "155--157", "-3", "999999"])
def test_invalid_sols_are_refused(archive, fetch, sols):
    with pytest.raises(ConfigError, match=r"sols should be like 155, 155-157"):
        fetch(archive, sols=sols)


@pytest.mark.parametrize("url", ["ftp://x/", "x", "http://", "http://x:99999/", ""])
def test_an_invalid_base_url_is_refused(fetch, url):
    with pytest.raises(ConfigError, match=r"archive.toml: missions.MER2: "):
        fetch(ArchiveServer(url=url))


def test_the_shipped_archive_names_every_instrument_of_both_rovers():
    archive = load_archive()
    assert archive.mission("mer2").volume("NAVCAM") == "mer2no_0xxx"
    assert archive.mission("MER1").volume("rear_hazcam") == "mer1ho_0xxx"
    with pytest.raises(ConfigError, match="Spirit has no instrument 'mastcam'"):
        archive.mission("MER2").volume("mastcam")
    assert archive.mission("msl").volume("navcam") == "MSLNAV_0XXX"
    assert archive.mission("M20").volume("mastcam") == "mars2020_mastcamz_ops_raw"
    with pytest.raises(ConfigError, match="no mission 'LRO'; name one of MER2, MER1, MSL, M20"):
        archive.mission("LRO")


# On the command line, and in a process of its own


def arguments(archive_file: Path, out: Path) -> list[str]:
    return [
        *("fetch", "--mission", "MER2", "--sols", "155-157", "--instrument", "navcam"),
        *("--out", str(out), "--archive", str(archive_file)),
    ]


@pytest.mark.usefixtures("engine")
def test_the_command_reports_its_result(archive, images, tmp_path):
    from solmap.flows.cli import app  # noqa: PLC0415 - slow to import

    path = next(iter(images))
    data = archive.files.pop(path)
    call = arguments(Fetcher(tmp_path, []).settings(archive), tmp_path / "out")
    result = CliRunner().invoke(app, call)
    assert result.exit_code == 1
    assert f"failed {Path(path).name}: 127.0.0.1 answers 404" in result.output.replace("\n", "")
    archive.files[path] = data
    result = CliRunner().invoke(app, call)
    assert result.exit_code == 0
    assert "3 stereo pairs" in result.output
    assert "1 images fetched" in result.output


def test_a_killed_run_is_continued(archive, images, fetch):
    """The server keeps one file back until the process is killed; the next run takes the rest."""
    path = list(images)[-1]
    data = images[path]
    begun, killed = threading.Event(), threading.Event()

    def slowly(start):
        yield data[start : start + 60_000]
        begun.set()
        killed.wait(30)

    archive.files[path] = Served(len(data), slowly, '"slow"')
    command = [sys.executable, "-m", "solmap.flows.cli"]
    out = fetch.folder / "out"
    process = subprocess.Popen(
        [*command, *arguments(fetch.settings(archive), out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    assert begun.wait(90)
    while not any(part.stat().st_size for part in out.rglob("*.part")):
        assert process.poll() is None
        time.sleep(0.02)
    process.kill()
    process.wait()
    killed.set()
    archive.put(path, data, '"slow"')
    archive.requests.clear()
    assert fetch(archive).succeeded
    assert here(out) == queried(images)
    arrived = [request for request in archive.requests if request.path in images]
    assert path in {request.path for request in arrived}
    assert len(arrived) < len(images)


def test_an_index_of_sixty_thousand_rows_is_searched_from_a_stream(archive, images, fetch):
    """As long as Spirit's Navcam index: 56 MB, made while they are sent, cut now and then."""
    count, template = 60_000, index_row("2n111111111eff1000p1500l0m1.img", 1)
    real = b"".join(index_row(Path(path).name, 155) for path in images)

    def row(k: int) -> bytes:
        eye = (b"l0m1", b"r0m1")[k % 2]
        clock = b"%09d" % (126_400_000 + 100 * (k // 2))
        made = template.replace(b"111111111", clock).replace(b"l0m1", eye)
        return made.replace(b'\t1   \t"', b'\t%-4d\t"' % (1 + k // 400))

    def table(start: int) -> Iterator[bytes]:
        first, inside = divmod(start, ROW_BYTES)
        head = real[start:] if start < len(real) else b""
        if head:
            yield head
            first, inside = len(real) // ROW_BYTES, 0
        for k in range(first, count):
            yield row(k)[inside:]
            inside = 0

    archive.files[TABLE] = Served(count * ROW_BYTES, table, '"table"')
    archive.files[LABEL] = Served(
        len(index_label(count)), lambda start: iter([index_label(count)[start:]])
    )
    archive.faults[TABLE] = [{"cut": 10_000_000}] * 5  # more than the attempts that are allowed
    report = fetch(archive, sols="155", out=fetch.folder / "big")
    assert (report.pairs, report.fetched) == (3, 6)
    assert not report.warnings
    first, *others = archive.requested(TABLE)
    assert first.range is None
    assert len(others) == 5
    assert 0 < int(others[-1].range.strip("bytes=-")) <= 50_000_000
    assert (fetch.folder / "big/.fetch/mer2no_0xxx/edrindex.tab").stat().st_size == 55_980_000
