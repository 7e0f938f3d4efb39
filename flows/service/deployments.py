"""The deployments that `solmap up` serves, as `python -m solmap.flows.service.deployments`.

One run at a time: a run uses both cores already, and two runs of a mission would only wait for each
other.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from solmap.config.run_parameters import RUN_KINDS
from solmap.config.settings import Settings
from solmap.flows.runtime.children import lower_priority

if TYPE_CHECKING:
    from prefect import Flow

DOWNLINK, OVERALL, REGION, FETCH = (
    RUN_KINDS[kind].deployment for kind in ("downlink", "overall adjustment", "region", "fetch")
)
"""Names for requesting runs: flow and deployment."""


def served(settings: Settings) -> Iterator[tuple[Flow[..., Any], dict[str, Any]]]:
    """The flows that may be requested, and their deployments; some run by a schedule."""
    from solmap.flows.service import deployed  # noqa: PLC0415 - after the engine's settings

    yield (
        deployed.process_inbox,
        _options(
            DOWNLINK,
            "Process all files of the inbox to published layers; existing products are kept.",
            "downlink",
            settings.downlink_cron if settings.inbox else None,
        ),
    )
    yield (
        deployed.adjust_missions,
        _options(
            OVERALL,
            "Adjust all stops of every mission together; map again those that moved.",
            "adjustment",
            settings.overall_cron,
        ),
    )
    yield deployed.refresh_missions, _options(REGION, "Join stops into regions again.", "region")
    yield (
        deployed.fetch_to_inbox,
        _options(
            FETCH, "Download the stereo pairs of some sols from the archive to the inbox.", "fetch"
        ),
    )


def _options(name: str, description: str, tag: str, cron: str | None = None) -> dict[str, Any]:
    from prefect.types.entrypoint import EntrypointType  # noqa: PLC0415

    return {
        "name": name.partition("/")[2],
        "description": description,
        "tags": ["solmap", tag],
        "cron": cron,
        "entrypoint_type": EntrypointType.MODULE_PATH,
    }


def _is_paused(name: str) -> bool:
    """Whether people have paused a deployment; deploying it again would resume it."""
    from prefect.client.orchestration import get_client  # noqa: PLC0415 - after its settings
    from prefect.exceptions import ObjectNotFound  # noqa: PLC0415

    with get_client(sync_client=True) as client:
        try:
            return client.read_deployment_by_name(name).paused
        except ObjectNotFound:
            return False


def main() -> None:
    """Serve the deployments until stopped.

    A runner that was given flows runs these, whatever entry point, path or pull steps the engine
    has of their deployments; with deployments (`prefect.serve`) it would follow the engine's.
    """
    from prefect.runner import Runner  # noqa: PLC0415 - the environment was prepared by `solmap up`

    lower_priority()
    runner = Runner(name="solmap", limit=1, pause_on_shutdown=False)
    for flow, options in served(Settings()):
        name = f"{flow.name}/{options['name']}"
        runner.add_flow(flow, **options, paused=_is_paused(name))
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(runner.start())


if __name__ == "__main__":
    main()
