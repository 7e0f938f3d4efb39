"""Control frames in the stepwise adjustment, where earlier stops are held.

A frame was placed by control of stops that are held now, so it shares their errors: of what it is
off, the part that moves rigidly with the stop held last is taken over with that stop's error, and
the rest is what the step may correct.
"""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from dataclasses import replace

import numpy as np

from solmap.photogrammetry.adjustment.control import ControlFrame
from solmap.photogrammetry.adjustment.problem import Problem
from solmap.photogrammetry.adjustment.records import AdjustedNetwork, Network
from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId

LEAST_SHARE = 1e-6
"""Of the variances of a frame's place, at least so much is its own."""


def with_frames_as_left(
    network: Network, previous: AdjustedNetwork, held: AbstractSet[StopId]
) -> Network:
    """The network with its control frames where earlier steps left them.

    What a frame shares of the error of the stop held last, by which both were placed, is no error
    of one against the other; `_sensitivity` takes it over with that of the stop. Control of earlier
    stops that are estimated again serves twice, as their ties do.
    """
    left = {frame.frame.name: frame for frame in previous.frames}
    (datum,) = (stop for stop in previous.stops if stop.stop == _last(network, held))
    frames = []
    for frame in network.frames:
        before = left.get(frame.name)
        if before is None or frame.is_certain:
            frames.append(frame)
            continue
        T = carried_frame(frame, datum.lsl_from_rover)
        free = np.ix_(frame.is_free, frame.is_free)
        values, vectors = np.linalg.eigh((before.covariance - T @ datum.covariance @ T.T)[free])
        own = np.zeros_like(before.covariance)
        least = LEAST_SHARE * np.diagonal(before.covariance[free])
        own[free] = (vectors * np.maximum(values, 0.0)) @ vectors.T + np.diag(least)
        frames.append(replace(frame, place=before.place, covariance=own))
    return replace(network, frames=tuple(frames))


def _last(network: Network, held: AbstractSet[StopId]) -> StopId:
    """The last of the held stops along the traverse."""
    return [stop for stop in network.stop_ids if stop in held][-1]


def move_frames_along(
    N: np.ndarray, problem: Problem, stop: np.ndarray, frames: list[np.ndarray]
) -> None:
    """Let what is known of control frames beforehand move along with a held stop."""
    if problem.control is None:
        return
    unknowns = problem.unknowns
    for block, columns, W, T in zip(
        unknowns.frame_blocks, unknowns.frame_columns, problem.control.prior, frames, strict=True
    ):
        free = columns >= 0
        own = unknowns.offsets[block] + columns[free]
        cross = -(W.T @ W @ T)[free]
        N[np.ix_(own, stop)] += cross
        N[np.ix_(stop, own)] += cross.T


def carried_frame(frame: ControlFrame, pose: Pose) -> Float64[np.ndarray, "5 6"]:
    """How a motion of a stop (d, dc) moves a control frame that is carried along rigidly."""
    east, north = frame.centre_m
    n, e = north - pose.translation_m[0], east - pose.translation_m[1]
    T = np.zeros((5, 6))
    T[0, 4] = T[1, 3] = 1.0
    T[0, 2], T[1, 2] = n, -e
    T[2, 5], T[2, 0], T[2, 1] = -1.0, -e, n
    T[3, 2] = -1.0
    return T
