"""Fixtures shared by all tests: random numbers, and the real and rendered data where they are."""

import contextlib
import gc
import json
import os
import re
import tarfile
import tempfile
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
import typer.testing

hypothesis.settings.register_profile("patient", deadline=None)
# what the tests say of a commit they say again: `make test-all` searches on with other examples
hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True, max_examples=40)
hypothesis.settings.load_profile("patient")  # no test asserts a time: other work shares the machine

ROOT = Path(__file__).resolve().parents[1]


SHARED = {
    "mapped": "mapped",
    "images_url": "images",
    "true_images": "images",
    "stereo": "stereo",
    "engine": "engine",
}
"""Fixtures of a session that take ten seconds and more to make or to run, and what they share."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """A file stays on one worker, and so do all files with a test that takes one of `SHARED`."""
    from xdist.scheduler import LoadFileScheduling  # noqa: PLC0415 - not installed everywhere

    class Scheduling(LoadFileScheduling):
        @cache  # noqa: B019 - as long as the run
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            taken = re.findall(r"(?:def \w+|usefixtures)\(([^)]*)\)", (ROOT / file).read_text())
            words = set(re.findall(r"\w+", " ".join(taken)))
            shared = next((group for fixture, group in SHARED.items() if fixture in words), None)
            return f"{Path(file).parts[1]}/{shared}" if shared else file

    return Scheduling(config, log)


def pytest_collection_finish() -> None:
    """Collections of garbage look at what tests made, not at half a million objects of modules."""
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish() -> None:
    """Collect garbage once, so that pytest's five times find nothing more to look at."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """What a test prints may hold half a character, which its worker could not send."""
    report = yield
    report.sections = [
        (name, text.encode(errors="backslashreplace").decode()) for name, text in report.sections
    ]
    return report


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers that are the same in every run."""
    return np.random.default_rng(20040104)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of shared facts and data beside the repository; skips where it is absent."""
    folder = Path(os.environ.get("SOLMAP_SHARED", ROOT.parent / "shared"))
    if not folder.is_dir():
        pytest.skip("the shared folder with facts and data is not beside this checkout")
    return folder


@pytest.fixture(scope="session")
def shared_data(shared: Path) -> Path:
    """Real rover images, labels and traverses."""
    return shared / "data"


@pytest.fixture(scope="session")
def test_vectors() -> dict[str, Any]:
    """Numbers from JPL's own C code, and of labels that JPL wrote."""
    return json.loads((ROOT / "tests" / "fixtures" / "jpl_vectors.json").read_text())


@pytest.fixture(scope="session")
def husband(shared_data: Path) -> Path:
    """The rendered three-stop traverse with its truth, unpacked once into an ignored folder."""
    folder = ROOT / ".cache" / "rendered_husband"
    if not folder.is_dir():
        archive = shared_data / "rendered_husband.tar.xz"
        if not archive.is_file():
            pytest.skip("rendered_husband.tar.xz is not among the shared data")
        folder.parent.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as draft, tarfile.open(archive) as tar:
            tar.extractall(draft, filter="data")
            with contextlib.suppress(OSError):  # another worker was first
                (Path(draft) / folder.name).rename(folder)
    return folder


@pytest.fixture(autouse=True)
def _folder_of_the_tests() -> None:
    """Commands that run in this process leave the folder that they were started in."""
    os.chdir(ROOT)


@pytest.fixture(scope="session", autouse=True)
def _one_tree_of_commands() -> Iterator[None]:
    """Built once, where tests run commands: it takes longer than most of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("typer.testing._get_command", cache(typer.main.get_command))
        yield


@pytest.fixture(scope="session")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Prefect's embedded server with a database in a temporary folder, closed by a password.

    Each worker has its own. Commands that run in a test's process use it too: one that started
    another would leave the address and password of that one to all tests after it.
    """
    from solmap.flows.runtime.engine import (  # noqa: PLC0415 - before Prefect is imported
        address,
        await_engine,
        engine_child,
        free_port,
        password_file,
        prepare_engine,
    )

    folder, port = tmp_path_factory.mktemp("engine"), free_port()
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("PREFECT_HOME", str(folder / "prefect"))
        prepare_engine(folder)
        server = engine_child(folder, port, has_pages=False)
        server.start()
        reached_by = {
            "PREFECT_API_URL": f"{address(port)}/api",
            "PREFECT_API_AUTH_STRING": password_file(folder).read_text(),
        }
        for name, value in reached_by.items():
            environment.setenv(name, value)
        from prefect import settings  # noqa: PLC0415
        from prefect.logging.handlers import APILogHandler  # noqa: PLC0415

        await_engine(server, port)
        with settings.temporary_settings(
            {getattr(settings, name): value for name, value in reached_by.items()}
        ):
            yield
        APILogHandler().flush()  # of all loggers
        server.stop()


@pytest.fixture(scope="session")
def postgres() -> Iterator[Any]:
    """A PostgreSQL server; skips where it is not installed."""
    from tests.support.postgres import NoPostgresError, running_postgres  # noqa: PLC0415

    try:
        with running_postgres() as server:
            yield server
            from solmap.products.catalogue.database import close_pools  # noqa: PLC0415 - slow to import

            close_pools()  # before the server stops
    except NoPostgresError as error:
        pytest.skip(str(error))


@pytest.fixture(params=["SQLite", "PostgreSQL"])
def catalogue_url(request: pytest.FixtureRequest) -> Iterator[str | None]:
    """Where a catalogue may lie: in its store's folder, or in a database of PostgreSQL."""
    if request.param == "SQLite":
        yield None
        return
    from solmap.products.catalogue.database import close_pools  # noqa: PLC0415 - slow to import

    yield request.getfixturevalue("postgres").database()
    close_pools()
