"""Settings from the environment: where things are and how the server listens."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from solmap.config import archive, landing
from solmap.products.store.backends import ObjectStorage


class TaskRunnerName(StrEnum):
    """What carries out the tasks of a flow."""

    THREADS = "threads"
    """Of the flow's own process."""
    DASK = "dask"
    """Workers of a Dask cluster."""


class Settings(BaseSettings):
    """Everything that differs from one machine to the next; `SOLMAP_STORE` and so on set it."""

    model_config = SettingsConfigDict(env_prefix="SOLMAP_")

    store: Path = Path("solmap-store")
    """Folder of products and catalogue."""
    catalogue_url: str | None = Field(default=None, repr=False)
    """Database of the catalogue, as `postgresql+psycopg://user:password@host/database`; SQLite in
    the store's folder where there is none. It may hold a password: it is shown nowhere."""
    store_url: str | None = None
    """Object store of the products, as `s3://bucket/prefix`, with keys and endpoint by the usual
    `AWS_*` variables; the store's folder where there is none."""
    store_cache_gb: float = 20.0
    """Copies of such products that this machine keeps at most."""
    host: str = "127.0.0.1"
    """Address the server listens on; the default serves this machine only."""
    port: int = 8765
    cors_origins: str = ""
    """Other sites whose pages may ask this server, as `https://a.example https://b.example`;
    none by default."""
    public_url: str | None = None
    """Address that people reach the map at, for links to it: `https://maps.example.org`."""
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
    downlink_cron: str = "30 */6 * * *"
    """When the inbox is processed whether or not files came: after every downlink window, UTC."""
    overall_cron: str = "0 3 * * 0"
    """When all stops of every mission are adjusted together, UTC."""
    task_runner: TaskRunnerName = TaskRunnerName.THREADS
    """What carries out the work on pairs, stops and maps."""
    task_workers: int = Field(default=2, ge=1)
    """Tasks at a time: each works on arrays of some hundred megabytes. For Dask without an address,
    processes on this machine."""
    dask_address: str | None = None
    """Scheduler of a Dask cluster whose workers reach the store, as `tcp://host:8786`."""
    engine_port: int = 4200
    """Port of Prefect's server and its run pages; it listens on this machine only."""

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
        prefix = self.model_config["env_prefix"]
        given = {name: value for name, value in self.model_dump().items() if value is not None}
        return {f"{prefix}{name.upper()}": str(value) for name, value in given.items()}
