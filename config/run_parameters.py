"""Runs that may be requested: their parameters, in plain values only, and descriptions.

The flows of deployments have the same parameter types (`flows.service.deployed`), the server
validates requests by these models, and the viewer makes its forms from their schemas.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

T = TypeVar("T")
MissionName = Annotated[str, Field(pattern=r"^[A-Za-z0-9]{1,16}$")]
Sols = Annotated[str, Field(pattern=r"^[0-9, \-]{1,200}$")]
Instrument = Literal["navcam", "pancam", "hazcam", "front_hazcam", "rear_hazcam"]
Settling = Annotated[float, Field(ge=0.0, le=86_400.0)]
_OfMission = Annotated[
    MissionName | None,
    Field(title="Mission", description="As its labels have it: MER2; all where none is given"),
]


class _Run(BaseModel):
    model_config = ConfigDict(extra="forbid")

    @property
    def parameters(self) -> dict[str, Any]:
        """The flow's parameters; omitted ones stay omitted."""
        given = self.model_dump(mode="json", exclude={"kind"})
        return {name: value for name, value in given.items() if value is not None}


def _none(value: object) -> object:
    if value is not None:
        raise ValueError("the inbox is processed for all missions: leave the mission out")
    return value


class DownlinkRun(_Run):
    """Process the inbox."""

    kind: Literal["downlink"]
    mission: Annotated[None, BeforeValidator(_none), Field(exclude=True)] = None
    settle_s: Annotated[
        Settling,
        Field(
            title="Seconds until a file counts as whole",
            description="Files that changed more recently are left for later",
        ),
    ] = 20.0


class OverallRun(_Run):
    """Adjust all stops together."""

    kind: Literal["overall adjustment"]
    mission: _OfMission = None


class RegionRun(_Run):
    """Join the regions."""

    kind: Literal["region"]
    mission: _OfMission = None


class FetchRun(_Run):
    """Fetch images from the archive."""

    kind: Literal["fetch"]
    mission: Annotated[MissionName, Field(title="Mission", description="MER1 or MER2")]
    sols: Annotated[
        Sols, Field(title="Sols", description="155, 155-157, or several of these with commas")
    ]
    instruments: Annotated[
        tuple[Instrument, ...],
        Field(title="Instruments", description="Cameras of which pairs are fetched", min_length=1),
    ] = ("navcam",)
    dry_run: Annotated[
        bool, Field(title="List only", description="List the images without fetching them")
    ] = False


RunSpecification = DownlinkRun | OverallRun | RegionRun | FetchRun


@dataclass(frozen=True, slots=True)
class RunKind:
    """A kind of run: its parameters, its deployment and its description."""

    model: type[DownlinkRun] | type[OverallRun] | type[RegionRun] | type[FetchRun]
    deployment: str
    """Flow and deployment in the engine."""
    effect: str


RUN_KINDS: dict[str, RunKind] = {
    "downlink": RunKind(
        DownlinkRun,
        "downlink/inbox",
        "All files in the inbox are taken in and every sol that they change is processed again. "
        "New versions of its layers are published; earlier versions stay in the store. "
        "Products that exist already are not computed again.",
    ),
    "overall adjustment": RunKind(
        OverallRun,
        "overall-adjustment/weekly",
        "All stops are adjusted in one network. Stops that move are mapped again and published as "
        "new versions; earlier versions stay in the store.",
    ),
    "region": RunKind(
        RegionRun,
        "refresh-region/on-demand",
        "The maps of stops are merged to regions again where a stop has changed, and published as "
        "new versions.",
    ),
    "fetch": RunKind(
        FetchRun,
        "fetch-archive/on-demand",
        "Stereo pairs are downloaded from the archive to the inbox. Files that are there already "
        "are not downloaded again; the inbox is processed when they are whole.",
    ),
}
