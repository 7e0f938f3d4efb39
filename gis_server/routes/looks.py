"""How a layer is to be shown, as a query."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from solmap.gis_server.rendering.styles import StyleQuery

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_NAME = r"^[a-z-]{1,32}$"
_DEFAULT = StyleQuery()


class AskedLook(BaseModel):
    """Style, colours and light of a picture. What a style has no use for is ignored."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    style: Annotated[str, Field(pattern=_NAME)] = _DEFAULT.style
    colours: Annotated[str | None, Field(pattern=_NAME, description="name of a ramp")] = None
    low: Annotated[_Finite | None, Field(description="value of the first colour")] = None
    high: Annotated[_Finite | None, Field(description="value of the last colour")] = None
    azimuth: Annotated[
        _Finite, Field(ge=-360, le=360, description="of the sun, degrees clockwise from north")
    ] = _DEFAULT.azimuth_deg
    elevation: Annotated[
        _Finite, Field(ge=0, le=90, description="of the sun above the horizon, degrees")
    ] = _DEFAULT.elevation_deg
    exaggeration: Annotated[_Finite, Field(gt=0, le=100, description="of heights, in shading")] = (
        _DEFAULT.exaggeration
    )
    threshold: Annotated[
        _Finite, Field(ge=-90, le=90, description="least tilt towards north, degrees")
    ] = _DEFAULT.threshold_deg
    baseline: Annotated[
        _Finite | None, Field(gt=0, le=100, description="length over which slope is felt, metres")
    ] = None
    interval: Annotated[
        _Finite | None, Field(ge=0.001, le=1000, description="between contours, metres")
    ] = None

    @property
    def look(self) -> StyleQuery:
        """The same without HTTP."""
        return StyleQuery(
            self.style,
            self.colours,
            self.low,
            self.high,
            self.azimuth,
            self.elevation,
            self.exaggeration,
            self.threshold,
            self.baseline,
            self.interval,
        )
