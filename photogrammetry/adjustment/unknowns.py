"""Where every unknown of the normal equations lies."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solmap.photogrammetry.adjustment.control import FRAME_UNKNOWNS
from solmap.photogrammetry.adjustment.observations import PAIR_UNKNOWNS, STOP_UNKNOWNS
from solmap.photogrammetry.arrays import Float64


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Which orientations are free, and their places: stop by stop, pose first, then its pairs."""

    sizes: np.ndarray
    offsets: np.ndarray
    stop_columns: np.ndarray
    """(stops, 6) place inside the stop's block; -1 where held."""
    pair_columns: np.ndarray
    """(pairs, 3) place inside the block of the pair's stop; -1 where masts do not turn."""
    pair_stop: np.ndarray
    per_pair: int
    """Unknowns of a pair: its pointing, or none where masts point as their labels say."""
    frame_columns: np.ndarray
    """(frames, 5) place inside the block of a control frame; -1 where certain. Blocks of frames
    follow those of stops."""
    count: int = field(init=False)
    """How many."""
    unpacked: tuple[np.ndarray, np.ndarray, np.ndarray] = field(init=False)
    """Places of the columns of stops, pairs and frames in the vector of unknowns."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "count", int(self.sizes.sum()))
        stops = np.arange(len(self.stop_columns))
        unpacked = (
            self.places(stops[:, None], self.stop_columns),
            self.places(self.pair_stop[:, None], self.pair_columns),
            self.places(self.frame_blocks[:, None], self.frame_columns),
        )
        object.__setattr__(self, "unpacked", unpacked)

    @classmethod
    def of(
        cls,
        held: np.ndarray,
        pair_stop: np.ndarray,
        *,
        turning: bool = True,
        frames: np.ndarray | None = None,
    ) -> Unknowns:
        """Number the unknowns of a network whose stops are held or free, and masts turn or not.

        `frames` (n, 5) tells what is unknown of the places of control frames.
        """
        free = np.zeros((0, FRAME_UNKNOWNS), dtype=bool) if frames is None else frames
        pose, per_pair = np.where(held, 0, STOP_UNKNOWNS), PAIR_UNKNOWNS if turning else 0
        per_stop = np.bincount(pair_stop, minlength=len(held)).astype(np.int64)
        of_stops = (pose + per_pair * per_stop).astype(np.int64)
        sizes = np.concatenate([of_stops, free.sum(axis=1).astype(np.int64)])
        frame_columns = np.where(free, np.cumsum(free, axis=1) - 1, -1)
        stop_columns = np.where(held[:, None], -1, np.arange(STOP_UNKNOWNS))
        by_stop = np.argsort(pair_stop, kind="stable")
        slot = np.zeros(len(pair_stop), dtype=np.int64)
        before = np.cumsum(per_stop) - per_stop
        slot[by_stop] = np.arange(len(pair_stop)) - np.repeat(before, per_stop)
        first = pose[pair_stop] + PAIR_UNKNOWNS * slot
        pair_columns = np.where(turning, first[:, None] + np.arange(PAIR_UNKNOWNS), -1)
        offsets = np.concatenate([[0], np.cumsum(sizes)])[:-1]
        return cls(sizes, offsets, stop_columns, pair_columns, pair_stop, per_pair, frame_columns)

    @property
    def frame_blocks(self) -> np.ndarray:
        """Blocks of the control frames."""
        return len(self.stop_columns) + np.arange(len(self.frame_columns))

    def columns(self, pair: np.ndarray) -> np.ndarray:
        """(…, 9) places inside the stop's block of the unknowns an observation by `pair` feels."""
        return np.concatenate(
            [self.stop_columns[self.pair_stop[pair]], self.pair_columns[pair]], axis=-1
        )

    def places(self, blocks: np.ndarray, local: np.ndarray) -> np.ndarray:
        """Places of columns in the vector of unknowns; what is held goes to a bin at its end."""
        return np.where(local >= 0, self.offsets[blocks] + local, self.count)

    def unpack(self, x: Float64[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Corrections (stops, 6), zero where held, (pairs, 3) and (frames, 5)."""
        padded, (stops, pairs, frames) = np.append(x, 0.0), self.unpacked
        return padded[stops], padded[pairs], padded[frames]
