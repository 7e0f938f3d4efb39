"""Settings from the environment: locations, and addresses of the server."""

from __future__ import annotations

import os
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict

from solmap.config import archive, landing
from solmap.config.records import ConfigError, nearest_name
from solmap.products.store.backends import ObjectStorage

PREFIX = "SOLMAP_"
PIPELINES = Path(__file__).parent / "pipelines"
"""Folder of the shipped pipelines."""


def _cron_line(text: str) -> str:
    if len(text.split()) not in {5, 6} and not text.startswith("@"):
        raise ValueError("it should have five fields, as `30 */6 * * *`")
    return text


CronLine = Annotated[str, AfterValidator(_cron_line)]
"""Schedule, read by Prefect."""


class TaskRunnerName(StrEnum):
    """Runner of the tasks of a flow."""

    THREADS = "threads"
    """Threads in the flow's own process."""
    DASK = "dask"
    """Workers of a Dask cluster."""


class Settings(BaseSettings):
    """Everything that differs between machines; set by `SOLMAP_STORE` and so on.

    A variable that is empty counts as not set.
    """

    model_config = SettingsConfigDict(env_prefix=PREFIX, env_ignore_empty=True)

    store: Path = Path("solmap-store")
    """Folder of products and catalogue."""
    catalogue_url: str | None = Field(default=None, repr=False)
    """Database of the catalogue, as `postgresql+psycopg://user:password@host/database`; SQLite in
    the store's folder by default. It may contain a password, so it is never shown."""
    store_url: str | None = None
    """Object store of the products, as `s3://bucket/prefix`, with keys and endpoint by the usual
    `AWS_*` variables; the store's folder by default."""
    store_cache_gb: float = Field(default=20.0, gt=0.0, allow_inf_nan=False)
    """Limit of local copies of such products."""
    host: str = "127.0.0.1"
    """Address the server listens on; by default only this machine can connect."""
    port: int = Field(default=8765, ge=1, le=65535)
    """Port the server listens on."""
    cors_origins: str = ""
    """Other sites whose pages may use this server, as `https://a.example https://b.example`; none
    by default."""
    public_url: str | None = Field(default=None, pattern=r"^https?://[^\s/?#]+(/[^\s?#]*)?$")
    """Public address of the map, for links to it and in the server's responses:
    `https://maps.example.org/solmap/`."""
    trusted_proxies: str = ""
    """Addresses or networks of reverse proxies, as `127.0.0.1,10.0.0.0/8`: only these may give the
    client and the scheme of a request (`X-Forwarded-For`, `X-Forwarded-Proto`)."""
    pipeline: str = "default"
    """Name of a shipped pipeline, or path of a TOML file."""
    landing_sites: Path = landing.SHIPPED
    """TOML file of landing points from another source."""
    archive: Path = archive.SHIPPED
    """TOML file of the archive's addresses, for another mirror."""
    instruments: Path = Path(__file__).parent / "instruments"
    """Folder of TOML files with inverse tables and flat fields, one per mission."""
    inbox: Path | None = None
    """Inbox of downlinks, watched by `solmap up`."""
    inbox_settle_s: float = Field(default=20.0, gt=0.0, allow_inf_nan=False)
    """Seconds without change after which a file of the inbox counts as complete."""
    downlink_cron: CronLine = "30 */6 * * *"
    """Schedule for processing the inbox even without new files, UTC: after every downlink
    window."""
    overall_cron: CronLine = "0 3 * * 0"
    """Schedule for adjusting all stops of every mission together, UTC."""
    task_runner: TaskRunnerName = TaskRunnerName.THREADS
    """Runner of the tasks of pairs, stops and maps."""
    task_workers: int = Field(default=2, ge=1, le=1024)
    """Tasks at a time: each works on arrays of some hundred megabytes. For Dask without an address,
    processes on this machine."""
    dask_address: str | None = None
    """Scheduler of a Dask cluster whose workers have access to the store, as `tcp://host:8786`."""
    engine_port: int = Field(default=4200, ge=1, le=65535)
    """Port of Prefect's server and its run pages; it listens on this machine only."""

    server_memory_mb: int = Field(default=1500, ge=600)
    """Memory for the map's server and the two processes for its heavy requests, megabytes: a third
    of it limits a single such request."""
    history_days: int = Field(default=90, ge=1, le=36_500)
    """Days after which records of runs are removed: solmap's own and those of its engine, with
    their tasks, messages and events."""
    debug: bool = False
    """Whether a command that ends with an unexpected error prints its traceback."""

    def __init__(self, **values: Any) -> None:  # noqa: ANN401 - any setting
        """Read the environment.

        Raises:
            ConfigError: a variable has an invalid value.
        """
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ConfigError("; ".join(_faults(error))) from None

    @property
    def object_storage(self) -> ObjectStorage | None:
        """Location of the products if not in the store's folder."""
        return ObjectStorage(self.store_url, self.store_cache_gb) if self.store_url else None

    @property
    def map_url(self) -> str:
        """Address of the map."""
        return (self.public_url or f"http://{self.host}:{self.port}").rstrip("/")

    @property
    def environment(self) -> dict[str, str]:
        """The environment variables that give another process the same settings."""
        given = {name: value for name, value in self.model_dump().items() if value is not None}
        return {PREFIX + name.upper(): str(value) for name, value in given.items()}


def _faults(error: ValidationError) -> Iterator[str]:
    for fault in error.errors():
        name = str(fault["loc"][0])
        value = f"={fault['input']!s:.60}" if Settings.model_fields[name].repr else ""
        reason = fault["msg"].removeprefix("Value error, ").replace("Input should", "it should")
        yield f"{PREFIX}{name.upper()}{value}: {reason}"


def unknown_variables() -> list[str]:
    """Messages on environment variables that look like settings but are not."""
    names = [f"{PREFIX}{name.upper()}" for name in Settings.model_fields]
    return [
        f"{name} is not a setting of solmap{nearest_name(name.upper(), names)}"
        for name in sorted(os.environ)
        if name.upper().startswith(PREFIX) and name.upper() not in names
    ]
