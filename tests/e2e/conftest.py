"""One synthetic downlink goes the whole way once, and the tests look at what came out."""

import json
import shutil
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from solmap.photogrammetry.synthetic.scene import WorldParams
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.products.catalogue.workspace import Workspace
from tests.support.bowl_store import fill
from tests.support.browsing import Server, launch_chromium, launch_firefox, open_driver, open_page
from tests.support.small_downlink import kept
from tests.support.stereo_viewer import fill as fill_with_images
from tests.unit.gis_server.stereo.stereo_store import StereoStore


@dataclass(frozen=True)
class Mapped:
    """A downlink, the store it was processed into, its report and its truth."""

    downlink: Path
    store: Path
    report: Any

    @property
    def workspace(self) -> Workspace:
        return Workspace.open(self.store)

    @property
    def truth(self) -> dict[str, Any]:
        return json.loads((self.downlink / "truth" / "truth.json").read_text())


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A synthetic downlink of two stops with six pairs each, of images of half the size."""
    from solmap.flows.simulation import write_downlink  # noqa: PLC0415 - slow to import

    world = kept(
        write_downlink, WorldParams("hills", TraverseParams(stops=2), pairs=6, averaging=2), 11
    )
    return shutil.copytree(world, tmp_path_factory.mktemp("world") / "downlink")


@pytest.fixture(scope="session")
def mapped(
    engine: None,  # noqa: ARG001 - the flow runs on it
    world: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> Mapped:
    """The downlink, taken all the way."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - needs the engine's settings

    store = tmp_path_factory.mktemp("store")
    return Mapped(world, store, process_downlink(world, store))


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run what is marked `both_browsers` in Firefox too; Playwright hears of no downloads there.

    `make test` starts Firefox once, for the tests of one file.
    """
    if metafunc.definition.get_closest_marker("both_browsers"):
        marks = () if metafunc.module.__name__.endswith("test_viewer") else pytest.mark.slow
        firefox = pytest.param("firefox", marks=marks)
        metafunc.parametrize("browser", ["chromium", firefox], indirect=True)


@pytest.fixture(scope="session")
def driver() -> Iterator[Any]:
    """Playwright, started once per process."""
    with open_driver() as opened:
        yield opened


@pytest.fixture(scope="session")
def chromium(driver: Any) -> Iterator[Any]:
    """A headless Chromium."""
    with launch_chromium(driver) as opened:
        yield opened


@pytest.fixture(scope="session")
def firefox(driver: Any) -> Iterator[Any]:
    """A headless Firefox."""
    with launch_firefox(driver) as opened:
        yield opened


@pytest.fixture
def browser(request: pytest.FixtureRequest) -> Any:
    """The browser of a test: Chromium, and in tests that are marked `both_browsers` Firefox too."""
    return request.getfixturevalue(getattr(request, "param", "chromium"))


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A page of a laptop's size."""
    with open_page(browser) as opened:
        yield opened


@pytest.fixture
def new_page(browser: Any) -> Iterator[Any]:
    """A page that no other test uses, for scripts that run before the viewer."""
    with open_page(browser, is_new=True) as opened:
        yield opened


@pytest.fixture(scope="session")
def bowl_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The store of the bowl, to be copied."""
    root = tmp_path_factory.mktemp("bowl") / "store"
    fill(Workspace.open(root))
    return root


@pytest.fixture(scope="session")
def url(bowl_store: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a server over the store of the bowl."""
    with Server(shutil.copytree(bowl_store, tmp_path_factory.mktemp("viewer") / "store")) as server:
        yield server.url


@pytest.fixture
def workspace(bowl_store: Path, tmp_path: Path) -> Workspace:
    """The store of the bowl, for a test that changes it."""
    return Workspace.open(shutil.copytree(bowl_store, tmp_path / "store"))


@pytest.fixture(scope="session")
def serve() -> Iterator[Callable[[Path], Server]]:
    """A server of the bowl of one test, at one address for all: pages have its scripts already.

    Browsers keep products by their digests, so another store needs another address.
    """
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield lambda store: Server(store, listener=listener)


@pytest.fixture
def live(workspace: Workspace, serve: Callable[[Path], Server]) -> Iterator[str]:
    """Address of a server over `workspace`."""
    with serve(workspace.store.root) as server:
        yield server.url


@pytest.fixture(scope="session")
def true_images(tmp_path_factory: pytest.TempPathFactory) -> StereoStore:
    """A store whose images, poses and ground are known."""
    return fill_with_images(tmp_path_factory.mktemp("images") / "store")


@pytest.fixture(scope="session")
def images_url(true_images: StereoStore) -> Iterator[str]:
    """Address of a server over the store of true images."""
    with Server(true_images.workspace.store.root) as server:
        yield server.url
