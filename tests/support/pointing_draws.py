"""Errors of adjusted stops, and their NEES, over many draws of mast pointing errors.

    python -m tests.support.pointing_draws husband .cache/worlds/day realistic-hills20 --draws 4

A world has one set of pointing errors, and one or two adjusted stops: too few to show whether its
covariances are true. So the images of a world are matched once; then pairs are rotated from their
true pointings by errors drawn for every network, then tied, linked and adjusted. A pair's error has
the standard deviation `--pointing` about each axis; with `--mast`, systematic errors are drawn for
the world too; every world has its own draws. The floor is that of `tests.support.accuracy`.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zlib import crc32

import numpy as np
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.adjustment.model.network import PairGeometry
from solmap.photogrammetry.adjustment.model.telemetry import mast_partials
from tests.support.accuracy import floors_of, pointing_errors
from tests.support.link_errors import truly_pointed
from tests.support.simulated_stops import SimulatedStop
from tests.support.stop_networks import StopError, evaluated, stops_of_world, world_folder

LINE = "{:20s} {:3d} stops: {:.3f} % ({:.3f}), azimuth {:.3f} ({:.3f}), tilt {:.3f} ({:.3f}) deg"


@dataclass(frozen=True, slots=True)
class Drawn:
    """An adjusted stop under one draw, and what an otherwise perfect adjustment would leave."""

    found: StopError
    floor: dict[str, float]

    @property
    def row(self) -> tuple[float, ...]:
        """Errors and floors of position (%), azimuth and tilt (degrees); NEES over 6."""
        one, floor = self.found, self.floor
        position = (100 * one.error_m / one.driven_m, floor["percent"])
        azimuth = (one.azimuth_deg, abs(floor["azimuth_deg"]))
        return (*position, *azimuth, one.tilt_deg, floor["tilt_deg"], one.nees)


def redrawn(
    stop: SimulatedStop, mast: np.ndarray, sigma: float, rng: np.random.Generator
) -> tuple[SimulatedStop, np.ndarray]:
    """A truly pointed stop with new pointing errors, and their mean rotation, label to true."""
    pairs, misses = [], []
    for pair in stop.matched.pairs:
        of_mast = mast_partials([PairGeometry(pair.pair_id, stop.stop, pair.geometry)])[0] @ mast
        error = Rotation.from_rotvec(of_mast + rng.normal(0, sigma, 3))
        turn = pair.geometry.rover_from_pair.rotation
        pairs.append(replace(pair, geometry=pair.geometry.turn(turn.T @ error.as_matrix() @ turn)))
        misses.append(error.inv().as_rotvec())
    mean = Rotation.from_rotvec(np.mean(misses, axis=0)).as_matrix()
    return replace(stop, matched=replace(stop.matched, pairs=tuple(pairs))), mean


def draws_of(world: str, draws: int, pointing: float, mast: float) -> Iterator[Drawn]:
    """The adjusted stops of a world under each draw; standard deviations in radians."""
    true = [truly_pointed(stop, world_folder(world)) for stop in stops_of_world(world)]
    for seed in range(draws):
        rng = np.random.default_rng([seed, crc32(Path(world).name.encode())])
        shared = rng.normal(0, mast, 4)
        drawn = [redrawn(stop, shared, pointing, rng) for stop in true]
        poses = [(s.true.rotation, mean, s.true.translation_m) for s, mean in drawn]
        floors = floors_of(poses, pointing_errors(poses))
        _, errors = evaluated([stop for stop, _ in drawn])
        yield from map(Drawn, errors, floors[1:])


def summary(name: str, rows: Sequence[tuple[float, ...]]) -> str:
    """Medians, floors in brackets, and the mean of NEES / 6."""
    table = np.array(rows)
    *medians, _ = np.median(table, axis=0)
    return LINE.format(name[-20:], len(rows), *medians) + f"; NEES / 6 {table[:, -1].mean():.2f}"


def main() -> None:
    """Read the names of worlds, draw, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.pointing_draws")
    parser.add_argument("worlds", nargs="+", help="as of tests.support.stop_networks")
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--pointing", type=float, default=0.1, help="degrees, each axis and pair")
    parser.add_argument("--mast", type=float, default=0.0, help="degrees, each systematic error")
    options = parser.parse_args()
    sigmas = (float(np.radians(options.pointing)), float(np.radians(options.mast)))
    everything: list[tuple[float, ...]] = []
    for world in options.worlds:
        rows = [one.row for one in draws_of(world, options.draws, *sigmas)]
        everything += rows
        print(summary(world, rows), flush=True)  # noqa: T201
    print(summary("all", everything))  # noqa: T201


if __name__ == "__main__":
    main()
