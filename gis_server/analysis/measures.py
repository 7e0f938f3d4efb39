"""Profiles, lines, areas and volumes on the ground."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, Field

from solmap.gis_server.analysis.bodies import (
    UNITS,
    LayerChoice,
    LayerUsed,
    Line,
    Polygon,
    Question,
    UnanswerableError,
    json_number,
    json_numbers,
)
from solmap.gis_server.analysis.ground import BEST, Ground
from solmap.photogrammetry.arrays import Flags
from solmap.photogrammetry.terrain.dtm.resampling import NOWHERE, GroundSamples, MapPoints
from solmap.photogrammetry.terrain.measure.areas import (
    BasePlane,
    places_inside,
    polygon_of,
    surface_ratio,
    volume,
)
from solmap.photogrammetry.terrain.measure.lines import (
    SAME_M,
    Profile,
    measure_line,
    profile,
    rise_between,
    stations,
)
from solmap.photogrammetry.terrain.relief.slope import CORRELATION_M
from solmap.products.crs import LandingPoint, lon_lat
from solmap.products.formats.documents.csv_table import csv_table

_STEEP_PLACES = 10_000
"""Sample points of an area; its slope is read at each of them and four around it."""
_RIM_STEP_M = 0.1
_STRETCH_M = 100.0
"""Length over which the direction of the meridian is computed."""
_USUAL_STATIONS = 1000
"""Number of stations on a line without a given step; short lines have one per cell."""


class LineQuestion(Question):
    """A line on the map."""

    line: Line
    layer: LayerChoice = BEST
    step_m: Annotated[float, Field(gt=0, le=1000)] = 0.5
    """Step at which the length along the ground is measured: shorter steps include noise."""


class RiseBody(BaseModel):
    """From the first place of the line to its last."""

    map_distance_m: float
    straight_m: float
    rise_m: float
    sigma_rise_m: float
    slope_deg: float
    sigma_slope_deg: float
    azimuth_deg: float
    """Clockwise from the map's north."""
    true_azimuth_deg: float
    """Clockwise from the meridian of the first place."""


class LineAnswer(BaseModel):
    """Length and directions of a line."""

    units: str = UNITS
    map_length_m: float
    surface_length_m: float
    """Length along the ground; the length on the map is used where the ground was not measured."""
    step_m: float
    measured_share: float
    leg_length_m: list[float | None]
    leg_azimuth_deg: list[float | None]
    ends: RiseBody | None
    """null: an end has no elevation, or the line is closed."""
    layers: list[LayerUsed]


class AreaQuestion(Question):
    """A polygon on the map."""

    polygon: Polygon
    layer: LayerChoice = BEST


class AreaAnswer(BaseModel):
    """Size of a polygon."""

    units: str = UNITS
    map_area_m2: float
    surface_area_m2: float | None
    """Area of the ground by its slope over half a metre; gaps have the mean slope of the rest."""
    perimeter_m: float
    """Perimeter on the map."""
    centre: tuple[float, float]
    """(east, north) of the centroid."""
    elevation_mean_m: float | None
    elevation_min_m: float | None
    elevation_max_m: float | None
    sigma_elevation_mean_m: float | None
    """Standard deviation of the mean elevation; null: the model states none."""
    sigma_elevation_min_m: float | None
    sigma_elevation_max_m: float | None
    measured_share: float
    cell_m: float
    """Cell size at which the ground was read."""
    layers: list[LayerUsed]


class VolumeQuestion(AreaQuestion):
    """A polygon on the map, and the base of its volume."""

    base: Literal["rim", "level", "lowest"] = "rim"
    """rim: the plane that fits the ground along the outline; level: `elevation_m`; lowest: a level
    plane at the lowest ground of the outline."""
    elevation_m: Annotated[float, Field(ge=-1e5, le=1e5)] | None = None


class VolumeAnswer(BaseModel):
    """The volume between the ground and a base."""

    units: str = UNITS
    above_m3: float
    sigma_above_m3: float
    below_m3: float
    sigma_below_m3: float
    net_m3: float
    sigma_net_m3: float
    map_area_m2: float
    measured_share: float
    highest_m: float
    """Largest height of the ground above the base."""
    sigma_highest_m: float
    lowest_m: float
    sigma_lowest_m: float
    base: str
    base_elevation_m: float
    """Elevation of the base at the polygon's centroid."""
    base_slope_deg: float
    sigma_base_slope_deg: float
    cell_m: float
    layers: list[LayerUsed]


def line_answer(question: LineQuestion, ground: Ground, landing: LandingPoint) -> LineAnswer:
    """Length, directions and rise of a line."""
    corners = np.array(question.line)
    along = stations(corners, question.step_m)
    read = ground.at(along.places)
    found = measure_line(corners, along, read)
    return LineAnswer(
        map_length_m=round(found.map_length_m, 4),
        surface_length_m=round(found.surface_length_m, 4),
        step_m=question.step_m,
        measured_share=round(found.measured_share, 4),
        leg_length_m=json_numbers(found.leg_length_m),
        leg_azimuth_deg=json_numbers(np.degrees(found.leg_azimuth), 3),
        ends=_rise_body(corners[[0, -1]], ground.at(corners[[0, -1]]), landing),
        layers=layers_used(read, ground),
    )


def _rise_body(places: MapPoints, read: GroundSamples, landing: LandingPoint) -> RiseBody | None:
    if not np.isfinite(read.elevation).all() or np.hypot(*(places[1] - places[0])) < SAME_M:
        return None
    rise = rise_between(places, read)
    east, north = places[1] - places[0]
    return RiseBody(
        map_distance_m=round(rise.map_length_m, 4),
        straight_m=round(rise.straight_m, 4),
        rise_m=round(rise.rise_m, 4),
        sigma_rise_m=round(float(np.nan_to_num(rise.sigma_rise_m)), 4),
        slope_deg=round(math.degrees(rise.slope), 3),
        sigma_slope_deg=round(math.degrees(float(np.nan_to_num(rise.sigma_slope))), 3),
        azimuth_deg=round(math.degrees(math.atan2(east, north)) % 360.0, 3),
        true_azimuth_deg=round(true_azimuth(places, landing), 3),
    )


def true_azimuth(places: MapPoints, landing: LandingPoint) -> float:
    """Degrees from the meridian of the first place to the direction of the second.

    On a map that is not tied to the lander: from the north of its site.
    """
    step = places[1] - places[0]
    if landing.origin:
        return math.degrees(math.atan2(*step)) % 360.0
    ahead = places[0] + step * (_STRETCH_M / np.hypot(*step))
    (lon, lon_on), (lat, lat_on) = lon_lat(landing, *np.stack([places[0], ahead], axis=1))
    across = (lon_on - lon) * math.cos(math.radians((lat + lat_on) / 2))
    return math.degrees(math.atan2(across, lat_on - lat)) % 360.0


def area_answer(question: AreaQuestion, ground: Ground) -> AreaAnswer:
    """Area of a polygon on the map and on the ground."""
    polygon = polygon_of(np.array(question.polygon))
    places, cell = places_inside(polygon, ground.finest_cell_m, _STEEP_PLACES)
    read = ground.at(places)
    steep = surface_ratio(places, ground.elevation, 0.25)
    measured = np.isfinite(read.elevation)
    known, sigma = read.elevation[measured], read.sigma_m[measured]
    surface = polygon.area * float(np.nanmean(steep)) if np.isfinite(steep).any() else None
    return AreaAnswer(
        map_area_m2=round(polygon.area, 4),
        surface_area_m2=json_number(surface),
        perimeter_m=round(polygon.length, 4),
        centre=(round(polygon.centroid.x, 4), round(polygon.centroid.y, 4)),
        elevation_mean_m=json_number(float(known.mean())) if len(known) else None,
        elevation_min_m=json_number(float(known.min())) if len(known) else None,
        elevation_max_m=json_number(float(known.max())) if len(known) else None,
        sigma_elevation_mean_m=_sigma_of_mean(read, measured, polygon.area),
        sigma_elevation_min_m=json_number(float(sigma[known.argmin()])) if len(known) else None,
        sigma_elevation_max_m=json_number(float(sigma[known.argmax()])) if len(known) else None,
        measured_share=round(len(known) / len(places), 4),
        cell_m=round(cell, 6),
        layers=layers_used(read, ground),
    )


def _sigma_of_mean(read: GroundSamples, measured: Flags, area_m2: float) -> float | None:
    """Standard deviation of an area's mean elevation.

    Errors of poses shift the whole area, those of cells average out.
    """
    if not np.isfinite(read.sigma_m[measured]).any():
        return None
    shift = float(np.nan_to_num(read.pose_sigma_m[measured]).mean())
    own = float(np.nanmean(read.own_sigma_m[measured] ** 2))
    return json_number(math.sqrt(shift**2 + own * min(1.0, CORRELATION_M**2 / area_m2)))


def volume_answer(question: VolumeQuestion, ground: Ground) -> VolumeAnswer:
    """The volume of a polygon's ground against a base."""
    polygon = polygon_of(np.array(question.polygon))
    places, cell = places_inside(polygon, ground.finest_cell_m)
    base = _base(question, ground)
    read = ground.at(places)
    found = volume(places, read, base, polygon.area)
    centre = np.array([[polygon.centroid.x, polygon.centroid.y]])
    return VolumeAnswer(
        above_m3=round(found.above_m3, 6),
        sigma_above_m3=round(found.sigma_above_m3, 6),
        below_m3=round(found.below_m3, 6),
        sigma_below_m3=round(found.sigma_below_m3, 6),
        net_m3=round(found.net_m3, 6),
        sigma_net_m3=round(found.sigma_m3, 6),
        map_area_m2=round(found.area_m2, 4),
        measured_share=round(found.measured_share, 4),
        highest_m=round(found.highest_m, 4),
        sigma_highest_m=round(found.sigma_highest_m, 4),
        lowest_m=round(found.lowest_m, 4),
        sigma_lowest_m=round(found.sigma_lowest_m, 4),
        base=question.base,
        base_elevation_m=round(float(base.elevations(centre)[0]), 4),
        base_slope_deg=round(math.degrees(base.slope), 3),
        sigma_base_slope_deg=round(math.degrees(base.sigma_slope), 3),
        cell_m=round(cell, 6),
        layers=layers_used(read, ground),
    )


def _base(question: VolumeQuestion, ground: Ground) -> BasePlane:
    if question.base == "level":
        if question.elevation_m is None:
            raise UnanswerableError("a level base needs its elevation: give `elevation_m`")
        return BasePlane.level(question.elevation_m)
    ring = np.array([*question.polygon, question.polygon[0]])
    length = float(np.hypot(*np.diff(ring, axis=0).T).sum())
    step = max(_RIM_STEP_M, length / 2000)
    along = stations(ring, step)
    read = ground.at(along.places)
    if question.base == "rim":
        return BasePlane.fit(along.places, read, step)
    if not np.isfinite(read.elevation).any():
        raise UnanswerableError("no ground of the outline was measured: draw it on mapped ground")
    return BasePlane.level(float(np.nanmin(read.elevation)))


def layers_used(read: GroundSamples, ground: Ground) -> list[LayerUsed]:
    """The terrain models that places were read from."""
    numbers_used = np.unique(read.source[read.source != NOWHERE]).tolist()
    return [LayerUsed.of(ground.models[k]) for k in numbers_used]


class ProfileQuestion(Question):
    """A line on the map, and parameters of its profile."""

    line: Line
    layer: LayerChoice = BEST
    step_m: Annotated[float, Field(gt=0)] | None = None
    """Largest distance of stations; by default a cell, or a thousandth of the line."""
    slope_baseline_m: Annotated[float, Field(gt=0, le=100)] = 0.5
    """Length over which the slope along the line is found."""


class ProfileAnswer(BaseModel):
    """Values at stations along the line, in its direction; one list per quantity."""

    units: str = UNITS
    length_m: float
    """Length on the map."""
    step_m: float
    slope_baseline_m: float
    distance_m: list[float | None]
    east: list[float | None]
    north: list[float | None]
    leg: list[int]
    """Number of the leg of the line; a corner ends one."""
    elevation_m: list[float | None]
    sigma_m: list[float | None]
    """Standard deviation of the elevation, including that of the rover's poses: the uncertainty
    band."""
    pose_sigma_m: list[float | None]
    """The part of the poses: an error common to neighbouring stations."""
    slope_deg: list[float | None]
    """Slope along the line, positive uphill."""
    slope_sigma_deg: list[float | None]
    source: list[int | None]
    """Number of the layer, in `layers`, that the elevation is of."""
    layers: list[LayerUsed]


def profile_of(question: ProfileQuestion, ground: Ground) -> Profile:
    """The profile of a line over terrain models."""
    corners = np.array(question.line)
    length = float(np.hypot(*np.diff(corners, axis=0).T).sum())
    step = question.step_m or max(ground.finest_cell_m, length / _USUAL_STATIONS)
    along = stations(corners, step)
    return profile(along, ground.at(along.places), question.slope_baseline_m)


def profile_answer(question: ProfileQuestion, found: Profile, ground: Ground) -> ProfileAnswer:
    """Response with the profile."""
    used = sorted({int(k) for k in found.ground.source.tolist() if k != NOWHERE})
    along = found.stations
    step = float(np.diff(along.distance_m).max())
    return ProfileAnswer(
        length_m=round(float(along.distance_m[-1]), 4),
        step_m=round(step, 6),
        slope_baseline_m=question.slope_baseline_m,
        distance_m=json_numbers(along.distance_m),
        east=json_numbers(along.places[:, 0]),
        north=json_numbers(along.places[:, 1]),
        leg=along.leg.tolist(),
        elevation_m=json_numbers(found.ground.elevation),
        sigma_m=json_numbers(found.ground.sigma_m),
        pose_sigma_m=json_numbers(found.ground.pose_sigma_m),
        slope_deg=json_numbers(np.degrees(found.slope), 3),
        slope_sigma_deg=json_numbers(np.degrees(found.slope_sigma), 3),
        source=[None if k == NOWHERE else used.index(k) for k in found.ground.source.tolist()],
        layers=[LayerUsed.of(ground.models[k]) for k in used],
    )


def profile_csv(answer: ProfileAnswer) -> str:
    """The stations as a table; the layer's id and digest are in every row."""
    ground = ("distance_m", "east", "north", "elevation_m", "sigma_m", "pose_sigma_m")
    columns = (*ground, "slope_deg", "slope_sigma_deg")
    names = [(layer.id, layer.digest) for layer in answer.layers]
    sources = (("", "") if k is None else names[k] for k in answer.source)
    rows = zip(*(getattr(answer, column) for column in columns), sources, strict=True)
    return csv_table(
        (*columns, "layer", "digest"), ((*values, *source) for *values, source in rows)
    )
