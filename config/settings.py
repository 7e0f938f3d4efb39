"""Settings from the environment: where things are and how the server listens."""

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


def _cron_line(text: str) -> str:
    if len(text.split()) not in {5, 6} and not text.startswith("@"):
        raise ValueError("it should have five fields, as `30 */6 * * *`")
    return text


CronLine = Annotated[str, AfterValidator(_cron_line)]
"""When something is done; Prefect reads it."""


class TaskRunnerName(StrEnum):
    """What carries out the tasks of a flow."""

    THREADS = "threads"
    """Of the flow's own process."""
    DASK = "dask"
    """Workers of a Dask cluster."""


class Settings(BaseSettings):
    """Everything that differs from one machine to the next; `SOLMAP_STORE` and so on set it.

    A variable that is empty counts as not set.
    """

    model_config = SettingsConfigDict(env_prefix=PREFIX, env_ignore_empty=True)

    store: Path = Path("solmap-store")
    """Folder of products and catalogue."""
    catalogue_url: str | None = Field(default=None, repr=False)
    """Database of the catalogue, as `postgresql+psycopg://user:password@host/database`; SQLite in
    the store's folder where there is none. It may hold a password: it is shown nowhere."""
    store_url: str | None = None
    """Object store of the products, as `s3://bucket/prefix`, with keys and endpoint by the usual
    `AWS_*` variables; the store's folder where there is none."""
    store_cache_gb: float = Field(default=20.0, gt=0.0, allow_inf_nan=False)
    """Copies of such products that this machine keeps at most."""
    host: str = "127.0.0.1"
    """Address the server listens on; the default serves this machine only."""
    port: int = Field(default=8765, ge=1, le=65535)
    cors_origins: str = ""
    """Other sites whose pages may ask this server, as `https://a.example https://b.example`;
    none by default."""
    public_url: str | None = Field(default=None, pattern=r"^https?://[^\s/?#]+(/[^\s?#]*)?$")
    """Address that people reach the map at, for links to it and in what the server answers:
    `https://maps.example.org/solmap/`."""
    trusted_proxies: str = ""
    """Addresses or networks of reverse proxies, as `127.0.0.1,10.0.0.0/8`: these, and nobody else,
    name the client and the scheme of a request (`X-Forwarded-For`, `X-Forwarded-Proto`)."""
    pipeline: str = "default"
    """Name of a shipped pipeline, or path of a TOML file."""
    landing_sites: Path = landing.SHIPPED
    """TOML file of landing points, for those who prefer another source."""
    archive: Path = archive.SHIPPED
    """TOML file of the archive's addresses, for those with a mirror of their own."""
    instruments: Path = Path(__file__).parent / "instruments"
    """Folder of TOML files with inverse tables and flat fields, one a mission."""
    inbox: Path | None = None
    """Folder that downlinks arrive in; `solmap up` watches it."""
    inbox_settle_s: float = Field(default=20.0, gt=0.0, allow_inf_nan=False)
    """Seconds after which a file of the inbox that has not changed counts as whole."""
    downlink_cron: CronLine = "30 */6 * * *"
    """When the inbox is processed whether or not files came: after every downlink window, UTC."""
    overall_cron: CronLine = "0 3 * * 0"
    """When all stops of every mission are adjusted together, UTC."""
    task_runner: TaskRunnerName = TaskRunnerName.THREADS
    """What carries out the work on pairs, stops and maps."""
    task_workers: int = Field(default=2, ge=1, le=1024)
    """Tasks at a time: each works on arrays of some hundred megabytes. For Dask without an address,
    processes on this machine."""
    dask_address: str | None = None
    """Scheduler of a Dask cluster whose workers reach the store, as `tcp://host:8786`."""
    engine_port: int = Field(default=4200, ge=1, le=65535)
    """Port of Prefect's server and its run pages; it listens on this machine only."""

    server_memory_mb: int = Field(default=1500, ge=600)
    """Memory for the map's server and the two processes that answer its heavy requests, megabytes:
    a third of it bounds what one such request may take."""
    history_days: int = Field(default=90, ge=1, le=36_500)
    """Days after which records of runs are removed: solmap's own and those of the engine that it
    starts, with their tasks, messages and events."""
    debug: bool = False
    """Whether a command that ends with an unexpected error prints its traceback."""

    def __init__(self, **values: Any) -> None:  # noqa: ANN401 - any setting
        """Read the environment.

        Raises:
            ConfigError: a variable has a value that its setting cannot have.
        """
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ConfigError("; ".join(_faults(error))) from None

    @property
    def object_storage(self) -> ObjectStorage | None:
        """Where products lie if not in the store's folder."""
        return ObjectStorage(self.store_url, self.store_cache_gb) if self.store_url else None

    @property
    def map_url(self) -> str:
        """Where the map is."""
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
    """What is said of each environment variable that looks like a setting and is none."""
    names = [f"{PREFIX}{name.upper()}" for name in Settings.model_fields]
    return [
        f"{name} is no setting of solmap{nearest_name(name.upper(), names)}"
        for name in sorted(os.environ)
        if name.upper().startswith(PREFIX) and name.upper() not in names
    ]
