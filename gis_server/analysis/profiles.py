"""Profiles: question, answer, and the table that spreadsheets read."""

from __future__ import annotations

import csv
import io
from typing import Annotated

import numpy as np
from pydantic import BaseModel, Field

from solmap.gis_server.analysis.bodies import UNITS, LayerAsked, LayerUsed, Line, Question, numbers
from solmap.gis_server.analysis.ground import BEST, Ground
from solmap.photogrammetry.terrain.dtm.resampling import NOWHERE
from solmap.photogrammetry.terrain.measure.lines import Profile, profile, stations

_USUAL_STATIONS = 1000
"""Stations of a line whose step nobody chose; short lines have one a cell."""


class ProfileQuestion(Question):
    """A line on the map, and how it is to be read."""

    line: Line
    layer: LayerAsked = BEST
    step_m: Annotated[float, Field(gt=0)] | None = None
    """Largest distance of stations; by default a cell, or a thousandth of the line."""
    slope_baseline_m: Annotated[float, Field(gt=0, le=100)] = 0.5
    """Length over which the slope along the line is found."""


class ProfileAnswer(BaseModel):
    """Columns of stations along the line, in its direction."""

    units: str = UNITS
    length_m: float
    """On the map."""
    step_m: float
    slope_baseline_m: float
    distance_m: list[float | None]
    east: list[float | None]
    north: list[float | None]
    leg: list[int]
    """Number of the leg of the line; a corner ends one."""
    elevation_m: list[float | None]
    sigma_m: list[float | None]
    """Of the elevation, the part of the rover's poses included: the uncertainty band."""
    pose_sigma_m: list[float | None]
    """That part: it lifts or lowers neighbouring stations together."""
    slope_deg: list[float | None]
    """Along the line, positive uphill."""
    slope_sigma_deg: list[float | None]
    source: list[int | None]
    """Number of the layer, in `layers`, that the elevation is of."""
    layers: list[LayerUsed]


def ask_profile(question: ProfileQuestion, ground: Ground) -> Profile:
    """The profile of a line over terrain models."""
    corners = np.array(question.line)
    length = float(np.hypot(*np.diff(corners, axis=0).T).sum())
    step = question.step_m or max(ground.finest_cell_m, length / _USUAL_STATIONS)
    along = stations(corners, step)
    return profile(along, ground.at(along.places), question.slope_baseline_m)


def profile_answer(question: ProfileQuestion, found: Profile, ground: Ground) -> ProfileAnswer:
    """The profile as it is sent."""
    used = sorted({int(k) for k in found.ground.source.tolist() if k != NOWHERE})
    along = found.stations
    step = float(np.diff(along.distance_m).max())
    return ProfileAnswer(
        length_m=round(float(along.distance_m[-1]), 4),
        step_m=round(step, 6),
        slope_baseline_m=question.slope_baseline_m,
        distance_m=numbers(along.distance_m),
        east=numbers(along.places[:, 0]),
        north=numbers(along.places[:, 1]),
        leg=along.leg.tolist(),
        elevation_m=numbers(found.ground.elevation),
        sigma_m=numbers(found.ground.sigma_m),
        pose_sigma_m=numbers(found.ground.pose_sigma_m),
        slope_deg=numbers(np.degrees(found.slope), 3),
        slope_sigma_deg=numbers(np.degrees(found.slope_sigma), 3),
        source=[None if k == NOWHERE else used.index(k) for k in found.ground.source.tolist()],
        layers=[LayerUsed.of(ground.models[k]) for k in used],
    )


def profile_csv(answer: ProfileAnswer) -> str:
    """The stations as a table; the layer's id and digest stand in every row."""
    ground = ("distance_m", "east", "north", "elevation_m", "sigma_m", "pose_sigma_m")
    columns = (*ground, "slope_deg", "slope_sigma_deg")
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow((*columns, "layer", "digest"))
    names = [(layer.id, layer.digest) for layer in answer.layers]
    sources = (("", "") if k is None else names[k] for k in answer.source)
    rows = zip(*(getattr(answer, column) for column in columns), sources, strict=True)
    for *values, source in rows:
        table.writerow(["" if value is None else value for value in (*values, *source)])
    return text.getvalue()
