"""Traverses out of vector files, PLACES tables and location files: stops chained into the LSL."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solmap.photogrammetry.archive.vector_files import VectorFile, lsl_tree, poses
from solmap.photogrammetry.body_fixed import map_from_lsl
from solmap.photogrammetry.errors import FrameError, TraverseError
from solmap.photogrammetry.frames import LSL, Frame, FrameKind
from solmap.photogrammetry.traverse.records import Traverse


def traverse_of_vectors(files: Sequence[VectorFile], solution: str = "") -> Traverse:
    """The stops that vector files place, in the order of their counters; sites where no rover is.

    A file of sites alone gives the origins of the sites, which is where the rover stood when each
    was declared. Vector files name no sols; they are 0.

    Args:
        files: Of one mission.
        solution: Which of their solutions; by default the one that counts for each.

    Raises:
        TraverseError: nothing that they place is chained to the LSL.
    """
    chosen = [_only(file, solution) for file in files] if solution else list(files)
    given = poses(chosen)
    tree = lsl_tree(given).tree
    frames = sorted((pose.source for pose in given), key=lambda frame: frame.index)
    rovers = {frame.index[0] for frame in frames if frame.kind is FrameKind.ROVER}
    wanted = [f for f in frames if f.kind is FrameKind.ROVER or f.index[0] not in rovers]
    placed: dict[str, np.ndarray] = {}
    for frame in wanted:
        try:
            placed.setdefault(_name(frame), tree.pose(LSL, frame).translation_m)
        except FrameError:
            continue
    if not placed:
        names = ", ".join(file.source for file in files) or "no file"
        raise TraverseError(f"{names}: no stop is chained to the landing site; add the .svf")
    label = solution or next(iter({s.solution_id for f in chosen for s in f.solutions}), "")
    sols = np.zeros(len(placed), dtype=np.int32)
    return Traverse(label, tuple(placed), sols, map_from_lsl(np.array(list(placed.values()))))


def _only(file: VectorFile, solution: str) -> VectorFile:
    kept = tuple(one for one in file.solutions if one.solution_id == solution)
    return VectorFile(file.source, file.mission, file.kind, file.priority, kept)


def _name(frame: Frame) -> str:
    site, drive = frame.index[0], frame.index[1] if len(frame.index) > 1 else 0
    return f"{site}/{drive}"
