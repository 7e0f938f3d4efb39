"""Poses of rovers from SPICE kernels: CK, SPK, FK, LSK, SCLK, PCK or a meta-kernel.

For a spacecraft with the NAIF number n (-254 is Spirit) the kernels of the missions have

    n           the rover, in SPK files and of its clock (SCLK)
    1000 n      the rover frame, in CK files: x forward, y right, z down
    1000 n - 900    the landing site, and its topocentric frame: x north, y west, z up

so that the rover in the LSL (north, east, down) is the position of n from the landing site and the
rotation of its frame, with the signs of y and z changed. SPICE has one kernel pool per process:
kernels loaded here are unloaded at the end, and only one thread at a time uses it.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

from solmap.photogrammetry.arrays import Quaternion, Vector3
from solmap.photogrammetry.errors import VectorFileError
from solmap.photogrammetry.frames import quaternion_of_rotation

SUFFIXES = frozenset({".bc", ".bsp", ".tf", ".tls", ".tsc", ".tpc", ".tm"})
NAIF_NUMBERS: Mapping[str, int] = {"MER1": -253, "MER2": -254, "MSL": -76, "M20": -168}
_NED_FROM_TOPOCENTRIC = np.diag([1.0, -1.0, -1.0])
_POOL = threading.RLock()
_NOT_COVERED = "SPKINSUFFDATA", "NOFRAMECONNECT", "CKINSUFFDATA", "NOLOADEDFILES"


@dataclass(frozen=True, slots=True)
class Kernels:
    """The kernels that are loaded."""

    spice: ModuleType
    names: str
    """Names of the files, for messages."""

    def pose(self, mission: str, clock: float) -> tuple[Quaternion, Vector3] | None:
        """Attitude (scalar first) and position (metres) of a rover in the LSL.

        None where the kernels do not cover that time.

        Args:
            mission: Identifier: MER2.
            clock: Spacecraft clock, seconds.

        Raises:
            VectorFileError: a required kernel is missing or broken.
        """
        number = NAIF_NUMBERS.get(mission)
        if number is None:
            raise VectorFileError(
                f"{self.names}: the NAIF number of {mission} is not known; SPICE kernels are "
                f"supported for {', '.join(NAIF_NUMBERS)}"
            )
        spice, whole = self.spice, int(clock)
        with _POOL:
            try:
                seconds = spice.scs2e(number, str(whole)) + (clock - whole)
                site, rover = number * 1000 - 900, number * 1000
                level, body = spice.frmnam(site), spice.frmnam(rover)
                if not (level and body):
                    raise VectorFileError(
                        f"{self.names}: no frame {rover if level else site} of {mission}; add its "
                        "frames kernel (.tf)"
                    )
                rotation = spice.pxform(body, level, seconds)
                place_km, _ = spice.spkpos(str(number), seconds, level, "NONE", str(site))
            except spice.utils.exceptions.SpiceyError as error:
                if any(reason in str(error) for reason in _NOT_COVERED):
                    return None
                wrong = " ".join(str(getattr(error, "long", None) or error).split())[:200]
                raise VectorFileError(f"{self.names}: clock {clock:.3f}: {wrong}") from error
        turned = _NED_FROM_TOPOCENTRIC @ np.asarray(rotation)
        return quaternion_of_rotation(turned), _NED_FROM_TOPOCENTRIC @ place_km * 1000.0


@contextmanager
def open_kernels(files: Sequence[Path]) -> Iterator[Kernels]:
    """Load kernels for the duration of a block.

    Raises:
        VectorFileError: spiceypy is not installed, or a file is not a kernel.
    """
    names = ", ".join(file.name for file in files)
    try:
        import spiceypy as spice  # noqa: PLC0415 - the optional extra `spice`
    except ImportError as error:
        raise VectorFileError(
            f"{names}: SPICE kernels need spiceypy; install it by `pip install 'solmap[spice]'`"
        ) from error
    loaded: list[str] = []
    try:
        for file in files:
            try:
                with _POOL:
                    if spice.getfat(str(file))[0] == "?":
                        raise VectorFileError(f"{file.name}: not a SPICE kernel by its first bytes")
                    spice.furnsh(str(file))
            except spice.utils.exceptions.SpiceyError as error:
                wrong = " ".join(str(getattr(error, "long", None) or error).split())[:200]
                raise VectorFileError(f"{file.name}: not a SPICE kernel: {wrong}") from error
            loaded.append(str(file))
        yield Kernels(spice, names)
    finally:
        with _POOL:
            for name in reversed(loaded):
                spice.unload(name)
