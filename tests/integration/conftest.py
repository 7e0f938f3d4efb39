"""Integration tests run flows on Prefect's embedded server, with a database of their own."""

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="session")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Prefect's settings for a run, its database in a temporary folder."""
    from flows.engine import prepare_engine  # noqa: PLC0415 - before Prefect is imported

    prepare_engine(tmp_path_factory.mktemp("engine"))
    from prefect.testing.utilities import prefect_test_harness  # noqa: PLC0415

    with prefect_test_harness(server_startup_timeout=120):
        yield
