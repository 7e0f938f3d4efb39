"""Settings from the environment: where things are and how the server listens."""

from __future__ import annotations

from pathlib import Path

from pydantic_settings import BaseSettings, SettingsConfigDict

from config import archive, landing


class Settings(BaseSettings):
    """Everything that differs from one machine to the next; `SOLMAP_STORE` and so on set it."""

    model_config = SettingsConfigDict(env_prefix="SOLMAP_")

    store: Path = Path("solmap-store")
    """Folder of products and catalogue."""
    host: str = "127.0.0.1"
    """Address the server listens on; the default serves this machine only."""
    port: int = 8765
    pipeline: str = "default"
    """Name of a shipped pipeline, or path of a TOML file."""
    landing_sites: Path = landing.SHIPPED
    """TOML file of landing points, for those who prefer another source."""
    archive: Path = archive.SHIPPED
    """TOML file of the archive's addresses, for those with a mirror of their own."""
    instruments: Path = Path(__file__).parent / "instruments"
    """Folder of TOML files with inverse tables and flat fields, one a mission."""
