"""The deployments that `solmap up` serves, as `python -m solmap.flows.service.deployments`.

One run at a time: a run uses both cores already, and two runs of a mission would only wait for each
other.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from solmap.config.settings import Settings

if TYPE_CHECKING:
    from prefect import Flow
    from prefect.deployments.runner import RunnerDeployment

DOWNLINK, OVERALL, REGION, FETCH = (
    "downlink/inbox",
    "overall-adjustment/weekly",
    "refresh-region/on-demand",
    "fetch-archive/on-demand",
)
"""Names by which runs are asked for: flow and deployment."""


def deployments(settings: Settings, store: Path) -> list[RunnerDeployment]:
    """All deployments of a store; those with a schedule run by it."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - after the engine's settings
    from solmap.flows.fetch import fetch_archive  # noqa: PLC0415
    from solmap.flows.mission import refresh_regions  # noqa: PLC0415
    from solmap.flows.overall import adjust_all  # noqa: PLC0415

    made_from = {"store": str(store), "pipeline": settings.pipeline}
    inbox = {"downlink": str(settings.inbox.resolve())} if settings.inbox else {}
    return [
        _deployment(
            process_downlink,
            DOWNLINK,
            cron=settings.downlink_cron if inbox else None,
            parameters={**made_from, **inbox},
            description="Take everything in the inbox to published layers; what is made is kept.",
            tags=["solmap", "downlink"],
        ),
        _deployment(
            adjust_all,
            OVERALL,
            cron=settings.overall_cron,
            parameters=made_from,
            description="Adjust all stops of every mission together; map again those that moved.",
            tags=["solmap", "adjustment"],
        ),
        _deployment(
            refresh_regions,
            REGION,
            parameters=made_from,
            description="Join stops to regions anew.",
            tags=["solmap", "region"],
        ),
        _deployment(
            fetch_archive,
            FETCH,
            parameters={"instruments": ["navcam"], "out_dir": inbox.get("downlink", "")},
            description="Bring the stereo pairs of some sols from the archive to the inbox.",
            tags=["solmap", "fetch"],
        ),
    ]


def _deployment(flow: Flow[..., Any], name: str, **options: Any) -> RunnerDeployment:  # noqa: ANN401 - Prefect's own
    from prefect.types.entrypoint import EntrypointType  # noqa: PLC0415

    how = EntrypointType.MODULE_PATH
    made = flow.to_deployment(name.partition("/")[2], entrypoint_type=how, **options)
    return cast("RunnerDeployment", made)  # outside of an event loop it is no coroutine


def main() -> None:
    """Serve the deployments until told to stop."""
    settings = Settings()
    store = settings.store.resolve()
    from prefect import serve  # noqa: PLC0415 - the environment was prepared by `solmap up`

    serve(*deployments(settings, store), limit=1, pause_on_shutdown=False)


if __name__ == "__main__":
    main()
