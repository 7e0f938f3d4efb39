"""The scorecard of `tests.support.accuracy`: figures of worlds against the goals, as a page."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

NEAR_M, FAR_M = 25.0, 40.0
"""Up to where all links, and nine of ten, are to be found."""
NEES_OF_WORLD = (0.6, 1.5)
CHANCE = 0.05
"""Probability that any world counts as contradicting its covariances though all are true."""

Result = dict[str, Any]
"""Of one world, as `measured` gives it."""


def scorecard(results: Iterable[Result]) -> list[dict[str, Any]]:
    """One row a goal: what it is, what was reached over all worlds, and whether that holds it."""
    evaluated = [result for result in results if not result["failure"]]
    stops = [row for result in evaluated for row in _moved(result)]
    links = [link for result in evaluated for link in result["links"]]
    if not stops:
        return []
    percent, azimuth, tilt, nees = (
        np.abs([row[name] for row in stops])
        for name in ("percent", "azimuth_error_deg", "tilt_error_deg", "nees")
    )
    floors = {
        name: np.abs([row["floor"][name] for row in stops])
        for name in ("percent", "azimuth_deg", "tilt_deg")
    }
    worlds = [mean_nees(result) for result in evaluated]
    freedoms = [6 * len(_moved(result)) for result in evaluated]
    near = [link["linked"] for link in links if link["distance_m"] <= NEAR_M]
    far = [link["linked"] for link in links if NEAR_M < link["distance_m"] <= FAR_M]
    rows = [
        _goal("position, median, % of the way", np.median(percent), 0.1, floors["percent"]),
        _goal("position, worst stop, % of the way", percent.max(), 0.3, floors["percent"], np.max),
        _goal("azimuth, median, degrees", np.median(azimuth), 0.05, floors["azimuth_deg"]),
        _goal("tilt, median, degrees", np.median(tilt), 0.05, floors["tilt_deg"]),
        _between("NEES/6, mean over all stops", float(nees.mean()), (0.85, 1.15)),
        _between("NEES/6, lowest of a world", min(worlds), NEES_OF_WORLD),
        _between("NEES/6, highest of a world", max(worlds), NEES_OF_WORLD),
        _goal(
            "worlds whose NEES/6 contradicts their covariances", _contradicting(worlds, freedoms), 0
        ),
        _goal("false links", sum(link["false"] for link in links), 0),
    ]
    for name, some, least in ((f"to {NEAR_M:g} m", near, 1.0), (f"to {FAR_M:g} m", far, 0.9)):
        if some:
            rows.append(_between(f"links found {name}, share", float(np.mean(some)), (least, 1.0)))
    for band, limit_m in (("0-10", 0.005), ("10-20", 0.005), ("20-30", 0.01)):
        here = [result for result in evaluated if band in result["bias_m"]]
        bias, floor = (
            np.abs([result[name][band] for result in here]) for name in ("bias_m", "bias_floor_m")
        )
        if here:
            name = f"height bias at {band} m, median, m"
            rows.append(_goal(name, np.median(bias), limit_m, floor))
    return rows


def mean_nees(result: Result) -> float:
    """Over the stops of a world that are not held."""
    return _mean(row["nees"] for row in _moved(result))


def _contradicting(nees: Sequence[float], freedoms: Sequence[int]) -> int:
    """Number of worlds whose NEES / 6 true covariances leave to the tails of chi-square.

    The mean over few stops varies: of two, 95 % are between 0.37 and 1.94.
    """
    low, high = chi2.interval(1 - CHANCE / len(nees), freedoms) / np.array(freedoms)
    return int(((np.array(nees) < low) | (np.array(nees) > high)).sum())


def _moved(result: Result) -> list[dict[str, Any]]:
    return [row for row in result["stops"] if row["driven_m"]]


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def _goal(
    name: str, value: Any, limit: float, floor: np.ndarray | None = None, over: Any = np.median
) -> dict[str, Any]:
    lowest = None if floor is None else round(float(over(floor)), 4)
    return {
        "goal": name,
        "reached": round(float(value), 4),
        "asked": f"<= {limit:g}",
        "holds": bool(value <= limit),
        "floor": lowest,
        "in_reach": lowest is None or lowest <= limit,
    }


def _between(name: str, value: float, bounds: tuple[float, float]) -> dict[str, Any]:
    low, high = bounds
    requested = f"{low:g} to {high:g}"
    holds = low <= value <= high
    return {
        "goal": name,
        "reached": round(value, 3),
        "asked": requested,
        "holds": holds,
        "floor": None,
        "in_reach": True,
    }


def markdown(card: Iterable[dict[str, Any]], results: Iterable[Result]) -> str:
    """The scorecard as a page: goals first, then every stop and world."""
    results = list(results)
    goals = [
        (row["goal"], row["reached"], row["asked"], _or_dash(row["floor"]), _state(row))
        for row in card
    ]
    stops = [
        (
            result["world"],
            row["stop"].partition("-")[2],
            row["driven_m"],
            row["telemetry_error_m"],
            row["adjusted_error_m"],
            row["percent"],
            row["floor"]["percent"],
            row["azimuth_error_deg"],
            row["floor"]["azimuth_deg"],
            row["tilt_error_deg"],
            row["floor"]["tilt_deg"],
            row["nees"],
        )
        for result in results
        if not result["failure"]
        for row in _moved(result)
    ]
    worlds = [_world_row(result) for result in results]
    failures = [
        f"{r['world']} failed:\n\n```\n{r['failure']}\n```" for r in results if r["failure"]
    ]
    return "\n\n".join(
        [
            "# Accuracy",
            _table(("goal", "reached", "asked", "floor of mast pointing", ""), goals),
            _table(
                (
                    "world", "stop", "way m", "telemetry off m", "error m", "%", "floor %",
                    "azimuth °", "floor °", "tilt °", "floor °", "NEES/6",
                ),
                stops,
            ),
            _table(
                (
                    "world", "NEES/6 (floor)", "links found", "refused", "false",
                    "bias 0-10 m (floor)", "10-20 m", "20-30 m", "processor s a stop",
                ),
                worlds,
            ),
            *failures,
        ]
    ) + "\n"  # fmt: skip


def _world_row(result: Result) -> tuple[Any, ...]:
    if result["failure"]:
        return (result["world"], "failed", *["-"] * 6, result["cpu_s_a_stop"])
    linked = [link["linked"] for link in result["links"]]
    bias = [
        f"{result['bias_m'][band]} ({result['bias_floor_m'][band]})"
        if band in result["bias_m"]
        else "-"
        for band in ("0-10", "10-20", "20-30")
    ]
    return (
        result["world"] + (" (other code)" if result.get("of_other_code") else ""),
        f"{mean_nees(result):.2f} ({_mean(row['floor']['nees'] for row in _moved(result)):.2f})",
        sum(linked),
        len(linked) - sum(linked),
        sum(link["false"] for link in result["links"]),
        *bias,
        result["cpu_s_a_stop"],
    )


def _or_dash(value: Any) -> Any:
    return "-" if value is None else value


def _state(row: dict[str, Any]) -> str:
    if row["holds"]:
        return "held"
    return "**missed**" if row["in_reach"] else "**missed**, as by the floor"


def _table(heading: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    heading = list(heading)
    lines = [heading, ["---"] * len(heading), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)
