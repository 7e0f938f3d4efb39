"""Prefect's settings for a run on one machine; imported before Prefect is.

A run needs no network and no server of its own: without `PREFECT_API_URL` Prefect starts its
embedded server for as long as the run lasts. Its database lies in the store, and it reports nothing
to anybody. What is set in the environment wins.
"""

from __future__ import annotations

import os
from pathlib import Path


def prepare_engine(store: Path) -> None:
    """Set what Prefect reads at import; call before the first import of a flow."""
    defaults = {
        "PREFECT_HOME": str(store.resolve() / "prefect"),
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "PREFECT_CLOUD_ENABLE_ORCHESTRATION_TELEMETRY": "false",
        "DO_NOT_TRACK": "1",
        # The terminal shows progress and outcomes; Prefect's own lines are on its run page.
        "PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL",
        "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "300",
        # Small-block linear algebra is far slower with two BLAS threads than with one.
        "OPENBLAS_NUM_THREADS": "1",
    }
    for name, value in defaults.items():
        os.environ.setdefault(name, value)
    # Prefect makes the folder itself but not its parents, and then waits for its server in vain.
    Path(os.environ["PREFECT_HOME"]).expanduser().mkdir(parents=True, exist_ok=True)
