"""What the coordinates of a network refer to.

Images and telemetry determine only relative poses. The first stop is the datum: its position is the
one that telemetry gives, by definition, because the map begins there.

Its attitude is also fixed, and the stop is held, unless control determines north better. A
controlled image does: then north is measured twice, by the rover and by the image. An error of a
degree in the first azimuth moves the end of a traverse of 7 km by 120 m, and a held stop would
shift that error to the image or to the ties. The position of the first stop is then an observation
in the map itself, to `PLACE_SIGMA_M`, and its attitude is the one that telemetry measures with its
standard deviation. A first azimuth that is not FINE has the standard deviation of one propagated
over one drive.

An uncontrolled mosaic may be rotated by degrees, more than any azimuth that telemetry reports. Its
north adds nothing to that of the first stop, which stays held: the mosaic is registered to the map
and determines relative poses only. The same holds for an image whose georeference is declared
exact: its north is by definition that of the first stop.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Set as AbstractSet
from dataclasses import replace

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedNetwork
from solmap.photogrammetry.adjustment.model.network import MAP, ControlFrame, Network, StopControl
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.imagery import StopId

TURN = 3
"""Index of the rotation among a frame's unknowns."""
PLACE_SIGMA_M = 1e-3
"""Standard deviation of the first stop's position, which defines the map."""


def with_control(
    network: Network,
    frames: Iterable[ControlFrame],
    control: Iterable[StopControl],
    params: AdjustmentParams,
) -> Network:
    """A network with control; its first stop stays held unless a frame determines north better.

    `network` begins with the first stop of the traverse. Control of stops that it does not have is
    left out. A frame of the same name replaces the earlier one.
    """
    inside = set(network.stop_ids)
    of_stops = tuple(one for one in control if one.stop in inside)
    own = tuple(frames)
    names = {frame.name for frame in own}
    every = (*(frame for frame in network.frames if frame.name not in names), *own)
    joined = replace(network, frames=every, control=(*network.control, *of_stops))
    first_sigma = np.radians(_first_azimuth_sigma_deg(network, params))
    informative = [frame for frame in every if frame.name == MAP.name or not frame.is_certain]
    if not any(np.sqrt(frame.covariance[TURN, TURN]) < first_sigma for frame in informative):
        return joined
    datum = () if network.datum_is_observed else (_datum(network, params),)
    others = tuple(frame for frame in every if frame.name != MAP.name)
    return replace(joined, frames=(MAP, *others), control=(*datum, *joined.control))


def held_stops(network: Network) -> frozenset[StopId]:
    """The stops to hold as the datum: the first, or none if its position is observed instead."""
    if network.datum_is_observed:
        return frozenset()
    return frozenset(network.stop_ids[:1])


def control_differs(
    network: Network, adjusted: AdjustedNetwork, stops: AbstractSet[StopId]
) -> bool:
    """Whether the network's control of some stops, or its frames, differ from those adjusted."""
    now = [one for one in network.control if one.stop in stops]
    then = [one.control for one in adjusted.control if one.control.stop in stops]
    frames = {frame.name for frame in network.frames}
    if len(now) != len(then) or {frame.frame.name for frame in adjusted.frames} - frames:
        return True
    if bool(network.frames) != bool(adjusted.frames):
        return True
    return not all(any(one.is_same(other) for other in then) for one in now)


def with_remembered_frames(network: Network, adjusted: AdjustedNetwork) -> Network:
    """The network with the control frames of marginalised stops added where it lacks them.

    Control may be withdrawn; its effect on marginalised stops remains until the next overall
    adjustment.
    """
    names = {frame.name for frame in network.frames}
    named = set(adjusted.memory.frames) - names if adjusted.memory else set()
    lost = tuple(one.frame for one in adjusted.frames if one.frame.name in named)
    return replace(network, frames=(*network.frames, *lost)) if lost else network


def _first_azimuth_sigma_deg(network: Network, params: AdjustmentParams) -> float:
    fine = network.stops[0].is_fine
    return params.azimuth_fine_deg if fine else params.azimuth_step_deg


def _datum(network: Network, params: AdjustmentParams) -> StopControl:
    first = network.stops[0]
    pose = first.lsl_from_rover
    north, east, down = pose.translation_m.tolist()
    azimuth_deg, sigma = None, [PLACE_SIGMA_M] * 3
    if not first.is_fine:
        azimuth_deg = float(np.degrees(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0])))
        sigma.append(float(np.radians(_first_azimuth_sigma_deg(network, params))))
    C = np.diag(np.square(sigma))
    return StopControl(first.stop, MAP.name, east, north, C, -down, azimuth_deg)
