"""A store of true images and orientations, made once, and a client of its server."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from tests.unit.gis_server.stereo.stereo_store import StereoStore, build_stereo_store


@pytest.fixture(scope="session")
def stereo(tmp_path_factory: pytest.TempPathFactory) -> StereoStore:
    return build_stereo_store(tmp_path_factory.mktemp("stereo"))


@pytest.fixture(scope="session")
def stereo_client(stereo: StereoStore) -> Iterator[TestClient]:
    with TestClient(create_app(stereo.workspace.store.root)) as opened:
        yield opened
