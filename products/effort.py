"""What making something took: time by the clock, time of the processor, and memory.

Stages run beside each other as threads of one process. Time of the processor is therefore that of
the thread itself, without threads that a library starts of its own (OpenCV does). Memory can only
be asked of the process: `peak_rss_mb` is the most it has held since it began, and `rss_rise_mb` by
how much that mark rose meanwhile, whichever thread raised it. With one worker both are the stage's
own.
"""

from __future__ import annotations

import resource
import time
from dataclasses import dataclass, field


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


@dataclass(frozen=True, slots=True)
class Effort:
    """Where clocks and memory stood when something began."""

    wall: float = field(default_factory=time.monotonic)
    cpu: float = field(default_factory=time.thread_time)
    peak_mb: float = field(default_factory=_peak_mb)

    def spent(self) -> dict[str, float]:
        """Seconds and megabytes since then, in this thread."""
        peak = _peak_mb()
        return {
            "seconds": round(time.monotonic() - self.wall, 3),
            "cpu_s": round(time.thread_time() - self.cpu, 3),
            "peak_rss_mb": round(peak, 1),
            "rss_rise_mb": round(peak - self.peak_mb, 1),
        }
