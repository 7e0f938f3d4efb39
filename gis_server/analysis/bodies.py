"""Types of request and response bodies that several analyses share.

Names end in their unit: `_m` metres, `_deg` degrees, `_px` pixels. East, north and elevation are
metres of the mission's local map, elevation above the tangent plane at the landing point. Azimuths
are clockwise from north. Standard deviations are one sigma. `null` means "not measured".
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from solmap.photogrammetry.adjustment.model.adjusted_network import BLUNDER, UNUSED, USED
from solmap.photogrammetry.terrain.visibility.viewshed import Sight
from solmap.products.formats.raster.tiling import HALF_SIDE_M
from solmap.products.model import Layer, ProductRef

UNITS = (
    "metres, degrees and pixels as the names end; elevation above the tangent plane at the landing "
    "point; azimuth clockwise from north; sigma: one standard deviation; null: not measured"
)
MOST_CORNERS = 1000
"""Maximum number of corners of a line or polygon in a request."""

SIGHT_NAMES = {Sight.VISIBLE: "visible", Sight.HIDDEN: "hidden", Sight.UNKNOWN: "unknown"}
"""Visibility in responses."""

TIE_STATUS = {USED: "used", BLUNDER: "blunder", UNUSED: "unused"}
"""Status of observations of tie points in responses."""

MetresHere = Annotated[float, Field(ge=-HALF_SIDE_M, le=HALF_SIDE_M, allow_inf_nan=False)]
"""A coordinate of the local map, metres."""
Corner = tuple[MetresHere, MetresHere]
"""(east, north)."""
Line = Annotated[list[Corner], Field(min_length=2, max_length=MOST_CORNERS)]
Polygon = Annotated[list[Corner], Field(min_length=3, max_length=MOST_CORNERS)]
LayerChoice = Annotated[
    str,
    Field(
        max_length=200,
        description="id of a terrain model, as listed by /layers, or `best`: at every point the "
        "measured value of the smallest cells, among equal cells of the smallest deviation",
    ),
]


class Question(BaseModel):
    """A request body; unknown field names are rejected, so that typing errors are detected."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class LayerUsed(BaseModel):
    """A layer from which a response was computed."""

    id: str
    kind: str
    digest: str
    cell_m: float | None
    made_at: str

    @classmethod
    def of(cls, layer: Layer) -> LayerUsed:
        """The description of a layer."""
        ref = layer.ref
        return cls(
            id=layer.id,
            kind=str(ref.kind),
            digest=ref.digest,
            cell_m=layer.cell_m,
            made_at=layer.made_at,
        )


class NetworkUsed(BaseModel):
    """The adjusted network from which a response was computed."""

    scope: str
    digest: str

    @classmethod
    def of(cls, ref: ProductRef) -> NetworkUsed:
        """The description of a network."""
        return cls(scope=ref.scope.name, digest=ref.digest)


def json_numbers(values: Iterable[float] | np.ndarray, digits: int = 4) -> list[float | None]:
    """Rounded numbers for JSON, null for NaN."""
    rounded = np.round(np.asarray(values, dtype=np.float64), digits)
    return [value if np.isfinite(value) else None for value in rounded.tolist()]


def json_number(value: float | None, digits: int = 4) -> float | None:
    """A rounded number for JSON, null for NaN."""
    return None if value is None else json_numbers([value], digits)[0]


class UnanswerableError(Exception):
    """A valid request without a result; the message states the reason and what to try."""
