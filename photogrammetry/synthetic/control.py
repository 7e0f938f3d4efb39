"""Control of simulated networks: where an orbital image whose place is wrong shows their stops.

The image is shifted, turned and scaled as its georeference may be (`ControlFrame.covariance`), and
every place in it is off by what its registration states. The first stop, exact in `networks`, gets
the error of attitude that a first stop has: with control its attitude is no datum any more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solmap.photogrammetry.adjustment.control import FRAME_UNKNOWNS, ControlFrame, StopControl
from solmap.photogrammetry.adjustment.records import Network
from solmap.photogrammetry.adjustment.rotations import rotation_of_vector
from solmap.photogrammetry.arrays import Float64, Vector3
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.synthetic.networks import NetworkTruth, TelemetryErrors


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedControl:
    """An orbital image, what it shows, and where it truly lies."""

    frame: ControlFrame
    control: tuple[StopControl, ...]
    place: Float64[np.ndarray, " 5"]
    """The true one."""


def simulate_control(  # noqa: PLR0913 - one keyword for each thing that a test may vary
    rng: np.random.Generator,
    network: Network,
    truth: NetworkTruth,
    stops: Sequence[int],
    *,
    frame: ControlFrame | None = None,
    sigma_m: float = 0.1,
    sigma_up_m: float | None = None,
    sigma_azimuth_deg: float | None = None,
    noise: float = 1.0,
) -> SimulatedControl:
    """Where an orbital image shows some stops of a network.

    Args:
        rng: source of all randomness.
        network: of which `truth` is true.
        truth: where its stops are.
        stops: numbers of those that the image shows.
        frame: what is known of the image's place; its true place is drawn from that.
        sigma_m: of each coordinate of a place.
        sigma_up_m: of heights, if there are any.
        sigma_azimuth_deg: of azimuths, if there are any.
        noise: multiplies the errors of places, not those of the image's own place.
    """
    centres = np.array([pose.translation_m for pose in truth.lsl_from_rover])
    north, east = centres[:, :2].mean(axis=0).tolist()
    frame = frame or ControlFrame.claimed("orbit", (east, north), shift_m=10.0)
    place = frame.place.copy()
    free = np.array(frame.is_free)
    root = np.linalg.cholesky(frame.covariance[np.ix_(free, free)])
    place[free] += root @ rng.normal(size=int(free.sum()))
    sigma = [sigma_m, sigma_m]
    sigma += [sigma_up_m] if sigma_up_m else []
    sigma += [float(np.radians(sigma_azimuth_deg))] if sigma_azimuth_deg else []
    control = []
    for k in stops:
        seen = _seen(truth.lsl_from_rover[k], frame, place)
        given = [0, 1, *([2] if sigma_up_m else []), *([3] if sigma_azimuth_deg else [])]
        seen[given] += rng.normal(0, np.array(sigma) * noise)
        control.append(
            StopControl(
                network.stop_ids[k],
                frame.name,
                float(seen[0]),
                float(seen[1]),
                np.diag(np.square(sigma)),
                float(seen[2]) if sigma_up_m else None,
                float(np.degrees(seen[3])) if sigma_azimuth_deg else None,
            )
        )
    return SimulatedControl(frame, tuple(control), place)


def _seen(pose: Pose, frame: ControlFrame, place: np.ndarray) -> Float64[np.ndarray, " 4"]:
    """East, north, up and azimuth of a rover as the image has them."""
    shift, (b, a) = place[:3], place[3:FRAME_UNKNOWNS]
    centre = np.array(frame.centre_m)
    north, east, down = pose.translation_m.tolist()
    similarity = np.array([[1 + a, -b], [b, 1 + a]])
    u = centre + np.linalg.solve(similarity, np.array([east, north]) - centre - shift[:2])
    azimuth = np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]) + np.arctan2(b, 1 + a)
    return np.array([*u, -down - shift[2], azimuth])


def with_first_attitude_unsure(
    rng: np.random.Generator, network: Network, errors: TelemetryErrors | None = None
) -> Network:
    """The network with an error in the first attitude that telemetry reports.

    Its tilt alone; its azimuth with those of all stops up to the next that is measured (FINE), for
    they were propagated from it. What wheels measured stays.
    """
    errors = errors or TelemetryErrors()
    tilt = rng.normal(0, np.radians(errors.tilt_deg), 2)
    first = errors.azimuth_fine_deg if network.stops[0].is_fine else errors.azimuth_step_deg
    azimuth = rng.normal(0, np.radians(first))
    rotations = [stop.lsl_from_rover.rotation for stop in network.stops]
    turned = [_about_down(azimuth) @ rotation_of_vector(np.array([*tilt, 0.0])) @ rotations[0]]
    for stop, rotation in zip(network.stops[1:], rotations[1:], strict=True):
        azimuth = 0.0 if stop.is_fine else azimuth
        turned.append(_about_down(azimuth) @ rotation)
    places: list[Vector3] = [network.stops[0].lsl_from_rover.translation_m]
    for k in range(1, len(turned)):
        before, here = network.stops[k - 1].lsl_from_rover, network.stops[k].lsl_from_rover
        step = before.rotation.T @ (here.translation_m - before.translation_m)
        places.append(places[-1] + turned[k - 1] @ step)
    stops = tuple(
        replace(stop, lsl_from_rover=Pose(pose.target, pose.source, turned[k], places[k]))
        for k, (stop, pose) in enumerate((stop, stop.lsl_from_rover) for stop in network.stops)
    )
    return replace(network, stops=stops)


def _about_down(angle: float) -> np.ndarray:
    return rotation_of_vector(np.array([0.0, 0.0, angle]))
