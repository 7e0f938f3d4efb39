"""One scorecard over worlds with known truth: `make accuracy`.

Every world goes through `solmap run` with defaults and is compared with its truth as `solmap
evaluate` does it. Worlds are the folders with `truth/truth.json` below `--worlds` (rendered ones;
../shared/render/README.md describes how to make them), and simulated ones that this module makes.
Each writes its figures once, and again when code or world have changed; then `scorecard.md` and
`scorecard.json` are rewritten in the same folder. With `--only` other worlds keep their last
figures there, marked where those are of other code.

The floor is what mast pointing alone leaves of an otherwise perfect adjustment: a panorama can be
tied without error to others, but the rover is known to stand to it only as the mean of its pairs'
pointings. With the mean miss M_k of a stop's pairs (label rover to true rover) and T_k its true
pose, the first stop held, stop k comes to

    T_0 M_0^-1 T_0^-1 T_k M_k,

and the ground about the held stop is turned by T_0 M_0^-1 T_0^-1.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from solmap.flows.cli.evaluation import (
    RANGE_BANDS_M,
    TrueStop,
    attitude_error_deg,
    evaluate_positions,
    evaluate_terrain,
    true_elevation,
    true_stops,
)
from solmap.flows.cli.tables import position_rows
from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.synthetic.scene import WorldParams, realistic_params
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.archives import pose_of_document, read_ties
from solmap.products.formats.raster.raster import read_dtm
from solmap.products.model import ProductKind, ProductRef
from tests.support.husband_truth import true_pose
from tests.support.scorecard import markdown, scorecard
from tests.support.simulated_stops import ROOT
from tests.support.site_pairs import FALSE_BEYOND
from tests.support.small_downlink import FEW_LAYERS

CACHE = ROOT / ".cache"
CODE = ("photogrammetry", "products", "tasks", "flows", "config")
RENDERED = [CACHE / "worlds", CACHE / "rendered_husband"]
HOW_TO_RENDER = (
    "see the README of the folder `render` beside the shared data; simulated worlds only"
)

PointedStop: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
"""True rotation of a stop, mean miss of its pairs, and true position."""


@dataclass(frozen=True, slots=True)
class Level:
    """What is run, and how."""

    simulated: dict[str, tuple[WorldParams, int]]
    """Parameters and seed by name."""
    rendered: bool = True
    pipeline: str = ""
    """As TOML; none: the defaults."""


def _simulated(terrain: str, seed: int, *, realistic: bool = True) -> tuple[WorldParams, int]:
    traverse = TraverseParams(stops=3, stops_per_site=1, spacing_m=(12.0, 20.0))
    params = WorldParams(terrain, traverse)
    return (realistic_params(params, seed) if realistic else params), seed


SMALL = WorldParams("hills", TraverseParams(spacing_m=(2.0, 3.0)), pairs=4, averaging=4)
SMALL = replace(SMALL, pair_step=float(np.pi / 2))
LEVELS = {
    "quick": Level({"thumbnails": (SMALL, 3)}, rendered=False, pipeline=FEW_LAYERS),
    "full": Level(
        {
            "simulated-plains": _simulated("plains", 61),
            "simulated-hills": _simulated("hills", 62),
            "simulated-crater": _simulated("crater", 63),
            "as-labelled": _simulated("hills", 64, realistic=False),
        }
    ),
}


@cache
def code_digest() -> str:
    """Digest of all code that a result depends on."""
    files = [path for folder in CODE for path in (ROOT / folder).rglob("*")]
    kept = sorted(path for path in files if path.suffix in {".py", ".toml", ".lbl"})
    return hashlib.sha256(b"".join(path.read_bytes() for path in kept)).hexdigest()[:16]


def measured(world: Path, out: Path, pipeline: str) -> dict[str, Any]:
    """The figures of a world: run, unless that was done with this code, and evaluated."""
    kept, store = out / f"{world.name}.json", out / "stores" / world.name
    truth = (world / "truth" / "truth.json").read_bytes()
    made_of = [code_digest(), hashlib.sha256(truth + pipeline.encode()).hexdigest()[:16]]
    if kept.exists() and (known := json.loads(kept.read_text()))["made_of"] == made_of:
        return known
    shutil.rmtree(store, ignore_errors=True)
    store.mkdir(parents=True)
    seconds, failure = _run(world, store, pipeline)
    figures = {"world": world.name, "made_of": made_of, "failure": failure}
    figures |= {} if failure else evaluated(world, Workspace.open(store))
    figures["cpu_s_a_stop"] = round(seconds / len(json.loads(truth)["stops"]), 1)
    kept.write_text(json.dumps(figures, indent=1))
    shutil.rmtree(store)
    return figures


def _run(world: Path, store: Path, pipeline: str) -> tuple[float, str]:
    """Processor seconds of `solmap run`, and why it failed."""
    command = [sys.executable, "-m", "solmap.flows.cli", "run", str(world), "--store", str(store)]
    if pipeline:
        (store / "pipeline.toml").write_text(pipeline)
        command += ["--pipeline", str(store / "pipeline.toml")]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    own = ("PREFECT_", "SOLMAP_")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(own)}
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return seconds, "" if ran.returncode == 0 else (ran.stdout + ran.stderr)[-2000:]


def evaluated(world: Path, workspace: Workspace) -> dict[str, Any]:
    """Errors of stops, links and terrain, with the floor of mast pointing beside."""
    truth = world / "truth"
    rows = position_rows(workspace)
    stops, poses = evaluate_positions(rows, true_stops(truth)), pointed_stops(world)
    covariances = {row["stop"]: np.array(row["covariance"]) for row in rows}
    errors = pointing_errors(poses)
    floors = zip(floors_of(poses, errors), errors, strict=True)
    by_name = dict(zip(map(_name, true_stops(truth)), floors, strict=True))
    for row in stops:
        row["floor"], error = by_name[row["stop"].partition("-")[2]]
        if row["driven_m"]:
            square = float(error @ np.linalg.solve(covariances[row["stop"]], error))
            row["floor"]["nees"] = round(square / len(error), 3)
    figures = {
        "stops": stops,
        "links": links_of(world, workspace),
        "bias_m": {},
        "bias_floor_m": {},
    }
    if not (truth / "dtm.tif").exists():
        return figures
    held = next(row["stop"] for row in stops if row["driven_m"] == 0)
    bands = [row for row in evaluate_terrain(workspace, truth) if row["stop"] == held]
    dtm = read_dtm(workspace.store.path(workspace.catalogue.layer(held, ProductKind.DTM).ref))
    bias = {"{}-{}".format(*row["range_m"]): row["bias_m"] for row in bands}
    floor = bias_floors(dtm, true_elevation(dtm, truth / "dtm.tif"), *poses[0])
    return figures | {"bias_m": bias, "bias_floor_m": {band: floor[band] for band in bias}}


def links_of(world: Path, workspace: Workspace) -> list[dict[str, Any]]:
    """Every link that was tried: its last state, and its error."""
    true = {_name(stop): stop for stop in true_stops(world / "truth")}
    latest: dict[str, list[ProductRef]] = {}
    for ref in workspace.store.refs():
        if ref.kind is ProductKind.LINKS:
            latest.setdefault(ref.scope.name, []).append(ref)
    links = []
    for refs in latest.values():
        ref = max(refs, key=workspace.store.made_at)
        link = read_ties(workspace.store.path(ref))[1]
        one, other = (true[link[name].partition("-")[2]] for name in ("earlier", "later"))
        apart = one.rotation.T @ (other.position - one.position)
        error = pose_of_document(link["earlier_from_later"]).translation_m - apart
        distance_m, error_m = float(np.linalg.norm(apart)), float(np.linalg.norm(error))
        limit_m = FALSE_BEYOND[0] + FALSE_BEYOND[1] * distance_m
        links.append(
            {
                "link": ref.scope.name,
                "distance_m": round(distance_m, 2),
                "linked": link["linked"],
                "false": bool(link["linked"] and error_m > limit_m),
                "error_m": round(error_m, 4) if link["linked"] else None,
                "reason": link["reason"],
            }
        )
    return links


def _name(stop: TrueStop) -> str:
    return f"site{stop.site:04d}-drive{stop.drive:04d}"


def pointed_stops(world: Path) -> list[PointedStop]:
    """The stops of a world, in their order."""
    stops = true_stops(world / "truth")
    images = json.loads((world / "truth" / "truth.json").read_text())["images"]
    files = {path.stem.upper(): path for path in world.glob("sol*/edr/*.img")}
    poses = []
    for number, stop in enumerate(stops):
        names = [row["product_id"].upper() for row in images if row["stop"] == number]
        misses = []
        for name in sorted({n for n in names if n[23] == "L"}):
            image = read_image(files[name].read_bytes(), files[name].name).image
            miss = stop.rotation.T @ true_pose(world, image).rotation
            misses.append(Rotation.from_matrix(miss).as_rotvec())
        mean = Rotation.from_rotvec(np.mean(misses, axis=0)).as_matrix()
        poses.append((stop.rotation, mean, stop.position))
    return poses


def pointing_errors(stops: Sequence[PointedStop]) -> list[np.ndarray]:
    """Errors that mast pointing alone leaves at every stop, the first one held.

    Each of shape (6,): rotation vector, radians, then shift, metres, in the axes of the LSL.
    """
    (held, miss, origin), errors = stops[0], []
    turn = _turn(held, miss)
    for rotation, mean, position in stops:
        turned = Rotation.from_matrix(turn @ rotation @ mean @ rotation.T).as_rotvec()
        errors.append(np.concatenate([turned, (turn - np.eye(3)) @ (position - origin)]))
    return errors


def floors_of(stops: Sequence[PointedStop], errors: Sequence[np.ndarray]) -> list[dict[str, float]]:
    """Those errors in metres, per cent of the distance driven, and degrees."""
    floors, driven_m, before = [], 0.0, stops[0][2]
    for (rotation, _, position), error in zip(stops, errors, strict=True):
        driven_m += float(np.linalg.norm(position - before))
        before = position
        off_m = float(np.linalg.norm(error[3:]))
        turned = Rotation.from_rotvec(error[:3]).as_matrix() @ rotation
        azimuth_deg, tilt_deg = attitude_error_deg(turned, rotation)
        floors.append(
            {
                "error_m": round(off_m, 4),
                "percent": round(100 * off_m / driven_m, 3) if driven_m else 0.0,
                "azimuth_deg": azimuth_deg,
                "tilt_deg": tilt_deg,
            }
        )
    return floors


def bias_floors(
    dtm: Dtm, true: Raster, rotation: np.ndarray, mean: np.ndarray, position: np.ndarray
) -> dict[str, float]:
    """Height bias that mast pointing alone leaves of the held stop's terrain, by range, metres.

    Args:
        dtm: Its terrain model; cells without elevation do not count.
        true: True elevations of the same cells, metres.
        rotation: (3, 3), true LSL from rover.
        mean: (3, 3), mean miss of its pairs, label rover to true rover.
        position: (3,), true position in the LSL: north, east, down, metres.
    """
    east, north = dtm.grid.centres()
    places = np.stack(
        [*np.meshgrid(north - position[0], east - position[1], indexing="ij"), -true - position[2]]
    )
    shift = np.tensordot(_turn(rotation, mean) - np.eye(3), places, axes=1)
    by_north, by_east = np.gradient(true, north, east)
    raised = -shift[2] - by_north * shift[0] - by_east * shift[1]
    range_m = np.hypot(places[0], places[1])
    floors = {}
    for low, high in RANGE_BANDS_M:
        here = np.isfinite(dtm.elevation + raised) & (range_m >= low) & (range_m < high)
        floors[f"{low}-{high}"] = round(float(np.median(raised[here])), 4) if here.any() else 0.0
    return floors


def _turn(rotation: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Rotation of all ground by the mean miss of the held stop's pairs."""
    return rotation @ mean.T @ rotation.T


def worlds_of(folders: Iterable[Path]) -> list[Path]:
    """Folders that hold a downlink with its truth, and those right below them."""
    found = []
    for folder in folders:
        below = sorted(folder.iterdir()) if folder.is_dir() else []
        found += [one for one in (folder, *below) if (one / "truth" / "truth.json").exists()]
    return found


def main(arguments: list[str] | None = None) -> int:
    """Run what has not been run yet with this code, and write the scorecard."""
    from solmap.flows.simulation import write_downlink  # noqa: PLC0415 - brings the engine

    parser = argparse.ArgumentParser(prog="python -m tests.support.accuracy")
    parser.add_argument("--level", choices=LEVELS, default="full")
    parser.add_argument("--worlds", type=Path, nargs="*", default=RENDERED, help="rendered worlds")
    parser.add_argument("--out", type=Path, default=CACHE / "accuracy")
    parser.add_argument("--only", default="", help="part of the world's name")
    requested = parser.parse_args(arguments)
    level, out = LEVELS[requested.level], requested.out / requested.level
    out.mkdir(parents=True, exist_ok=True)
    worlds = worlds_of(requested.worlds) if level.rendered else []
    if level.rendered and not worlds:
        print(  # noqa: T201 - figures are what this makes
            f"no rendered worlds in {', '.join(map(str, requested.worlds))}: {HOW_TO_RENDER}"
        )
    results = []
    for name, (params, seed) in level.simulated.items():
        if requested.only in name:
            write_downlink(out / "worlds" / name, params, seed)
        worlds.append(out / "worlds" / name)
    for world in worlds:
        if requested.only in world.name:
            print(world.name, flush=True)  # noqa: T201
            results.append(measured(world, out, level.pipeline))
        elif (kept := out / f"{world.name}.json").exists():
            known = json.loads(kept.read_text())
            if known["failure"] or "bias_floor_m" in known:  # without: of an earlier version
                results.append(known | {"of_other_code": known["made_of"][0] != code_digest()})
    card = scorecard(results)
    (out / "scorecard.json").write_text(json.dumps({"card": card, "worlds": results}, indent=1))
    (out / "scorecard.md").write_text(markdown(card, results))
    print(f"{out / 'scorecard.md'}:\n\n{markdown(card, results)}")  # noqa: T201
    return 1 if any(result["failure"] for result in results) else 0


if __name__ == "__main__":
    sys.exit(main())
