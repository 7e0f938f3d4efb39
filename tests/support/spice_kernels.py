"""Small SPICE kernels of Spirit, with one pose in them: written through spiceypy."""

from __future__ import annotations

from pathlib import Path

import numpy as np

CLOCK = 134_000_000.0
"""Spacecraft clock, seconds."""
SPAN_S = 100_000.0
NUMBER = -254
ROVER, SITE = NUMBER * 1000, NUMBER * 1000 - 900
TEXTS = {
    "mer2.tls": """KPL/LSK
\\begindata
DELTET/DELTA_T_A = 32.184
DELTET/K         = 1.657D-3
DELTET/EB        = 1.671D-2
DELTET/M         = ( 6.239996D0 1.99096871D-7 )
DELTET/DELTA_AT  = ( 10, @1972-JAN-1, 32, @1999-JAN-1 )
\\begintext
""",
    "mer2.tsc": f"""KPL/SCLK
\\begindata
SCLK_KERNEL_ID             = ( @2004-01-01 )
SCLK_DATA_TYPE_{-NUMBER}        = ( 1 )
SCLK01_TIME_SYSTEM_{-NUMBER}    = ( 2 )
SCLK01_N_FIELDS_{-NUMBER}       = ( 2 )
SCLK01_MODULI_{-NUMBER}         = ( 4294967296 256 )
SCLK01_OFFSETS_{-NUMBER}        = ( 0 0 )
SCLK01_OUTPUT_DELIM_{-NUMBER}   = ( 1 )
SCLK_PARTITION_START_{-NUMBER}  = ( 0.0 )
SCLK_PARTITION_END_{-NUMBER}    = ( 1.0E+12 )
SCLK01_COEFFICIENTS_{-NUMBER}   = ( 0.0 64.184 1.0 )
\\begintext
""",
    "mer2.tf": f"""KPL/FK
\\begindata
FRAME_MER-2_TOPO          = {SITE}
FRAME_{SITE}_NAME      = 'MER-2_TOPO'
FRAME_{SITE}_CLASS     = 4
FRAME_{SITE}_CLASS_ID  = {SITE}
FRAME_{SITE}_CENTER    = {SITE}
TKFRAME_{SITE}_RELATIVE = 'J2000'
TKFRAME_{SITE}_SPEC     = 'ANGLES'
TKFRAME_{SITE}_UNITS    = 'DEGREES'
TKFRAME_{SITE}_AXES     = ( 3, 2, 3 )
TKFRAME_{SITE}_ANGLES   = ( -175.5, -104.6, 180.0 )
FRAME_MER-2_LOCAL_LEVEL    = {SITE - 10}
FRAME_{SITE - 10}_NAME      = 'MER-2_LOCAL_LEVEL'
FRAME_{SITE - 10}_CLASS     = 4
FRAME_{SITE - 10}_CLASS_ID  = {SITE - 10}
FRAME_{SITE - 10}_CENTER    = {SITE}
TKFRAME_{SITE - 10}_RELATIVE = 'MER-2_TOPO'
TKFRAME_{SITE - 10}_SPEC     = 'ANGLES'
TKFRAME_{SITE - 10}_UNITS    = 'DEGREES'
TKFRAME_{SITE - 10}_AXES     = ( 1, 2, 3 )
TKFRAME_{SITE - 10}_ANGLES   = ( 180.0, 0.0, 0.0 )
FRAME_MER-2_ROVER         = {ROVER}
FRAME_{ROVER}_NAME      = 'MER-2_ROVER'
FRAME_{ROVER}_CLASS     = 3
FRAME_{ROVER}_CLASS_ID  = {ROVER}
FRAME_{ROVER}_CENTER    = {NUMBER}
CK_{ROVER}_SCLK         = {NUMBER}
CK_{ROVER}_SPK          = {NUMBER}
\\begintext
""",
}
"""Leap seconds, clock (seconds from J2000) and frames, in the form of NAIF's documentation."""


def write_kernels(
    folder: Path, place_m: np.ndarray, attitude: np.ndarray, clock: float = CLOCK
) -> list[Path]:
    """Kernels that have Spirit at one pose in the frame of the landing site (north, east, down).

    Args:
        folder: Where to write them.
        place_m: (3,), metres.
        attitude: (3, 3), rover into that frame.
        clock: Spacecraft clock, seconds; they cover `SPAN_S` before and after.
    """
    import spiceypy as spice  # noqa: PLC0415 - an optional extra

    files = [folder / name for name in TEXTS]
    for file in files:
        file.write_text(TEXTS[file.name])
        spice.furnsh(str(file))
    try:
        begin, end = (spice.scs2e(NUMBER, str(int(clock + s))) for s in (-SPAN_S, SPAN_S))
        spk, ck = folder / "mer2.bsp", folder / "mer2.bc"
        handle = spice.spkopn(str(spk), "test", 0)
        state = np.array([*place_m / 1000.0, 0.0, 0.0, 0.0])
        times = np.linspace(begin, end, 4)
        level = "MER-2_LOCAL_LEVEL"
        spice.spkw09(
            handle, NUMBER, SITE, level, begin, end, "test", 1, 4, np.tile(state, (4, 1)), times
        )
        spice.spkcls(handle)
        # a C-matrix turns vectors of the reference frame into the rover frame
        quaternion = spice.m2q(np.ascontiguousarray(attitude.T))
        ticks = [spice.sce2c(NUMBER, time) for time in (begin, end)]
        handle = spice.ckopn(str(ck), "test", 0)
        spice.ckw03(
            handle, *ticks, ROVER, level, 0, "test", 2, ticks, [quaternion] * 2,
            np.zeros((2, 3)), 1, ticks[:1],
        )  # fmt: skip
        spice.ckcls(handle)
    finally:
        for file in files:
            spice.unload(str(file))
    return [*files, spk, ck]
