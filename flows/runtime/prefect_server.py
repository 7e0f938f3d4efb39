"""Prefect's server, as `python -m solmap.flows.runtime.prefect_server`, on this machine only.

Its settings, the port among them, come from the environment. `prefect server start` runs the same
application, but takes a third longer to start: it imports its command line first, and collects
garbage often, which `solmap.flows` makes rare.
"""

from __future__ import annotations

import uvicorn
from prefect.server.api.server import create_app
from prefect.settings import get_current_settings


def main() -> None:
    """Serve until stopped."""
    server = get_current_settings().server
    uvicorn.run(
        create_app(final=True),
        host=server.api.host,
        port=server.api.port,
        timeout_keep_alive=server.api.keepalive_timeout,
        log_level=server.logging_level.lower(),
    )


if __name__ == "__main__":
    main()
