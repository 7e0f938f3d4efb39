"""The stops of a rendered world with their pairs matched, kept on disk.

A rendered world is a folder with a downlink and `truth/truth.json`; it is called as its folder,
`rendered_` left out.
"""

import json
import pickle
from pathlib import Path

import numpy as np

from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.archive.partners import find_stereo_pairs
from solmap.photogrammetry.frames import LSL, Pose, rotation_of_quaternion
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.records import MatchedPair, MatchedStop
from solmap.photogrammetry.matching.stereo.dense import match_densely
from solmap.photogrammetry.matching.stereo.sparse import SparseParams, match_sparsely
from solmap.tasks.images.pairs import pair_geometry
from tests.support.simulated_stops import CACHE, SimulatedStop, WorldOfStops, code_digest
from tests.support.stereo_pairs import resample_pair

HUSBAND = WorldOfStops("husband", (0.0, 0.0), seed=0, stops=3)


def rendered_world(folder: Path) -> WorldOfStops:
    """Represents a rendered world in tables; it cannot be simulated."""
    name = folder.name.removeprefix("rendered_")
    return WorldOfStops(name, (0.0, 0.0), seed=0, stops=len(_truth(folder)["stops"]))


def rendered_stops(folder: Path) -> list[SimulatedStop]:
    """All stops of a rendered world."""
    return [rendered_stop(folder, number) for number in range(rendered_world(folder).stops)]


def rendered_stop(folder: Path, number: int) -> SimulatedStop:
    """A stop with its Navcam and Pancam pairs, placed by its telemetry."""
    world = rendered_world(folder)
    path = CACHE / f"{world.terrain}-{number}-{code_digest()}.pickle"
    if path.exists():
        return pickle.loads(path.read_bytes())  # noqa: S301 - written by this module
    truth = _truth(folder)
    row = truth["stops"][number]
    mission = f"MER{truth['images'][0]['product_id'][0]}"
    stop = StopId(mission, row["site"], row["drive"])
    telemetry, true = (
        Pose(LSL, stop.frame, rotation_of_quaternion(np.array(row[turn])), np.array(row[place]))
        for turn, place in (
            ("telemetry_quaternion_wxyz", "telemetry_position"),
            ("rover_to_lsl_quaternion_wxyz", "position"),
        )
    )
    pairs = matched_pairs(sorted((folder / f"sol{row['sol']:04d}" / "edr").glob("*.img")))
    matched = MatchedStop(stop, pairs, telemetry, np.zeros((6, 6)))
    made = SimulatedStop(world, number, matched, true)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(made, protocol=5))
    return made


def _truth(folder: Path) -> dict:
    return json.loads((folder / "truth" / "truth.json").read_text())


def matched_pairs(files: list[Path]) -> tuple[MatchedPair, ...]:
    """The stereo pairs among some files, matched sparsely and densely with the defaults."""
    reads = {r.image.id: r for r in (read_image(f.read_bytes(), f.name) for f in files)}
    pairs = []
    for pair in find_stereo_pairs([r.image for r in reads.values()]).pairs:
        left, right = reads[pair.left.id], reads[pair.right.id]
        images = resample_pair(left, right, pair_geometry(left.image, right.image))
        matches = match_sparsely(pair.id, images, SparseParams())
        name = left.image.instrument
        parallax, sun = match_densely(images).parallax_px, left.image.sun
        pairs.append(MatchedPair.of(pair.id, name, images, matches, parallax, sun))
    return tuple(pairs)
