"""`solmap up`: everything on one machine."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from typing import Annotated

import typer

from solmap.config.settings import Settings
from solmap.flows.console import fail, out
from solmap.flows.options import StoreOption
from solmap.products.store.locks import alone


def up(
    store: StoreOption = None,
    inbox: Annotated[
        Path | None, typer.Option(help="Folder that downlinks arrive in. [env: SOLMAP_INBOX]")
    ] = None,
    port: Annotated[int | None, typer.Option(help="Port of the map. [env: SOLMAP_PORT]")] = None,
) -> None:
    """Run everything: the map, the schedules, and whatever arrives in the inbox. Ctrl-C stops."""
    from solmap.flows.up import LOOK_EVERY_S, Machine  # noqa: PLC0415 - `solmap --help` answers at once

    settings = Settings()
    root = (store or settings.store).resolve()
    given = {"store": root, "inbox": inbox or settings.inbox, "port": port or settings.port}
    settings = settings.model_copy(update=given)
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    with alone(root / "up.lock") as is_alone:
        if not is_alone:
            fail(f"another `solmap up` runs on {root}; stop it first")
        machine = Machine(settings, lambda line: out.print(line, highlight=False))
        try:
            machine.start()
            out.print(f"map at http://{settings.host}:{settings.port}/", highlight=False)
            out.print(f"runs at {machine.engine_url}/  (Ctrl-C stops both)", highlight=False)
            while not stopping.wait(LOOK_EVERY_S):
                machine.tend()
        except TimeoutError as error:
            fail(str(error))
        finally:
            machine.stop()
