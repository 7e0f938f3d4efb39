"""Site and rover vector files: poses of sites and rover stops, by solution.

An SVF contains the frames of the sites, an RVF those of the rover at the stops of one site, each as
offset and orientation (quaternion, scalar first, frame into reference frame) in a reference frame:

    <rmc_file mission="MER2" variant="Master_SVF">
      <priority><entry solution_id="telemetry"/></priority>
      <solution solution_id="telemetry" name="SITE_FRAME" index1="11">
        <reference_frame name="SITE_FRAME" index1="10"/>
        <offset x="..." y="..." z="..."/>  <orientation s="..." v1="..." v2="..." v3="..."/>
      </solution> ...

Solutions imported from other sources also have sigma_m and sigma_deg, standard deviations of each
coordinate and rotation; JPL's files have none.

Of several solutions of a frame the first in the order of priority is used, of several at one rover
stop the one with the highest motion counter, of equal ones the last added.

A pair of SVF and RVFs is written together: sites as in the solution's chain, rovers in their sites,
so that composing both gives the stop's pose in the LSL.

The LSL is the frame of site 0, the lander. Where the given sites are not connected to it, the LSL
is the frame of the lowest site of the chain, which a note reports.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from solmap.photogrammetry.archive.xml_text import xml_root
from solmap.photogrammetry.arrays import Quaternion, Vector3
from solmap.photogrammetry.errors import FrameError, VectorFileError
from solmap.photogrammetry.frames import (
    LSL,
    Frame,
    FrameKind,
    FrameTree,
    Pose,
    rover_frame,
    site_frame,
)
from solmap.photogrammetry.imagery import MAX_FROM_SITE_M

MAX_COUNTERS = 16
MAX_PRIORITIES = 1000
"""Solutions in an order of priority; the files of the archive name six."""

Rank: TypeAlias = tuple[int, tuple[int, ...], str]
"""Rank of a solution: its reliability, its motion counter, the date it was added."""

_FRAMES = {
    "SITE_FRAME": FrameKind.SITE,
    "ROVER_FRAME": FrameKind.ROVER,
    "ROVER_NAV_FRAME": FrameKind.ROVER,
}
FRAME_NAMES = {FrameKind.SITE: "SITE_FRAME", FrameKind.ROVER: "ROVER_FRAME"}
Digits = Callable[[float], str]


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """One pose of a frame, by one solution."""

    solution_id: str
    kind: FrameKind
    counter: tuple[int, ...]
    """(site,) or the motion counter (site, drive, ...)."""
    reference_site: int
    offset_m: Vector3
    quaternion: Quaternion
    added: str
    """Date, as written in the file (ISO, so that it sorts)."""
    sigma_m: float | None = None
    """Standard deviation of each coordinate of the offset, if given."""
    sigma_deg: float | None = None
    """Standard deviation of each rotation."""

    @property
    def frame(self) -> Frame:
        """The frame whose pose it is."""
        if self.kind is FrameKind.SITE:
            return site_frame(self.counter[0])
        return rover_frame(self.counter[0], self.counter[1])

    @property
    def pose(self) -> Pose:
        """The pose of the frame in its reference site."""
        return Pose.of_quaternion(
            site_frame(self.reference_site), self.frame, self.quaternion, self.offset_m
        )


@dataclass(frozen=True, slots=True, eq=False)
class VectorFile:
    """A site or rover vector file."""

    source: str
    mission: str
    kind: Literal["svf", "rvf"]
    priority: tuple[str, ...]
    """Solutions from the most to the least reliable."""
    solutions: tuple[Solution, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LslTree:
    """The sites and stops of one group under the LSL."""

    tree: FrameTree
    origin_site: int | None
    """The site whose frame the LSL is: 0, the lander, where the group reaches it."""
    origins: Mapping[int, int]
    """The lowest site of its group, by site: of every known site."""


def parse_vector_file(text: str, source: str) -> VectorFile:
    """Read an SVF or RVF; `source` names it in messages.

    Raises:
        VectorFileError: the file is not a vector file, or one of its elements is broken.
    """
    root = xml_root(text, source, "rmc_file", "vector", VectorFileError)
    listed = [
        _attribute(entry, "solution_id", source) for entry in root.iterfind("./priority/entry")
    ]
    if len(listed) > MAX_PRIORITIES:
        raise VectorFileError(f"{source}: {len(listed)} entries of <priority> are too many")
    solutions = tuple(_solution(element, source) for element in root.iterfind("./solution"))
    if not solutions:
        raise VectorFileError(f"{source}: expected at least one <solution>, found none")
    kinds = {solution.kind for solution in solutions}
    return VectorFile(
        source=source,
        mission=_attribute(root, "mission", source),
        kind="svf" if kinds == {FrameKind.SITE} else "rvf",
        priority=tuple(dict.fromkeys(listed)),
        solutions=solutions,
    )


def best_poses(files: Sequence[VectorFile]) -> tuple[Pose, ...]:
    """Every site and rover stop in its site, by the preferred solution.

    Files of one mission only: frames carry no mission. The orders of priority of several files are
    merged; at the same rank the later file has precedence.
    """
    best = {one.frame: one for one in reversed(ranked(files))}
    return tuple(one.pose for one in best.values())


def ranked(files: Sequence[VectorFile]) -> list[Solution]:
    """All solutions in vector files of one mission, the most reliable first."""
    order = join_priorities(files)
    trust = {name: len(order) - place for place, name in enumerate(order)}

    def rank(one: Solution) -> Rank:
        return trust.get(one.solution_id, 0), one.counter, one.added

    stated = [solution for file in reversed(files) for solution in reversed(file.solutions)]
    return sorted(stated, key=rank, reverse=True)


def join_priorities(files: Sequence[VectorFile]) -> list[str]:
    """One order of solutions that keeps every file's; the first one's where they contradict."""
    order: list[str] = []
    for file in files:
        place = len(order)
        for name in reversed(file.priority):
            if name in order:
                place = order.index(name)
            else:
                order.insert(place, name)
    return order


def lsl_tree(
    given: Iterable[Pose], sites: Iterable[int] = (), origin: int | None = None
) -> LslTree:
    """Chain poses to the LSL of one group of sites: the lander's, or that of the lowest site.

    Poses connect frames in the given order, so the most reliable come first; one that would close a
    loop is skipped. Connected frames, in either direction, form a group. Its LSL is the frame of
    its lowest site: that of the lander, site 0, where the group reaches it.

    Args:
        given: sites in sites and stops in sites, from vector files or labels.
        sites: sites needed besides those of the poses; if given, only they determine the group.
        origin: the lowest site of the requested group.
    """
    neighbours, groups = _join(given)
    origins: dict[int, int] = {site: site for site in sites}
    for group in groups:
        members = [frame.index[0] for frame in group if frame.kind is FrameKind.SITE]
        origins |= dict.fromkeys(members, min(members))
    reached = {origins[site] for site in sites} or set(origins.values())
    root = min(reached, default=None) if origin is None else origin
    if root is None:
        return LslTree(FrameTree(), None, origins)
    waiting = [Pose.identity(LSL, site_frame(root))]
    placed: dict[Frame, Pose] = {}
    while waiting:
        pose = waiting.pop()
        placed[pose.source] = pose
        waiting += [
            next_pose if next_pose.target == pose.source else next_pose.inverse
            for next_pose in neighbours.get(pose.source, ())
            if pose.target not in {next_pose.target, next_pose.source}
        ]
    return LslTree(FrameTree(placed), root, origins)


def _join(given: Iterable[Pose]) -> tuple[dict[Frame, list[Pose]], list[list[Frame]]]:
    """The poses that connect the frames, without loops; and the groups of frames."""
    tied: dict[Frame, list[Pose]] = {}
    group_of: dict[Frame, list[Frame]] = {}
    for pose in given:
        one, other = (group_of.setdefault(f, [f]) for f in (pose.target, pose.source))
        if one is other:
            continue
        for frame in (pose.target, pose.source):
            tied.setdefault(frame, []).append(pose)
        small, large = sorted((one, other), key=len)
        large += small
        group_of |= dict.fromkeys(small, large)
    return tied, list({id(group): group for group in group_of.values()}.values())


def _solution(element: ET.Element, source: str) -> Solution:
    name = _attribute(element, "name", source)
    counter = _counter(element, source)
    kind = _FRAMES.get(name)
    if kind is None or len(counter) < (1 if kind is FrameKind.SITE else 2):
        raise VectorFileError(
            f"{source}: <solution name={name[:40]!a}> with counter {counter}: expected SITE_FRAME "
            "with index1 or ROVER_FRAME with index1 and index2"
        )
    reference = _child(element, "reference_frame", source)
    if _attribute(reference, "name", source) != "SITE_FRAME":
        raise VectorFileError(
            f"{source}: {name} {counter} refers to {reference.get('name')!a:.60}, not a SITE_FRAME"
        )
    solution = Solution(
        solution_id=_attribute(element, "solution_id", source),
        kind=kind,
        counter=counter,
        reference_site=_whole(reference, "index1", source),
        offset_m=_numbers(_child(element, "offset", source), "xyz", source),
        quaternion=_numbers(
            _child(element, "orientation", source), ("s", "v1", "v2", "v3"), source
        ),
        added=element.get("add_date", ""),
        sigma_m=_sigma(element, "sigma_m", source),
        sigma_deg=_sigma(element, "sigma_deg", source),
    )
    check_pose(solution, source)
    return solution


def check_pose(solution: Solution, source: str) -> None:
    """Reject what is not a pose, is impossibly far away, or refers to itself.

    Raises:
        VectorFileError: the message names the source and the frame.
    """
    try:
        distance_m = float(np.linalg.norm(solution.pose.translation_m))
    except FrameError as error:
        raise VectorFileError(f"{source}: {error}") from error
    if not distance_m <= MAX_FROM_SITE_M:
        raise VectorFileError(
            f"{source}: {solution.frame} lies {distance_m:.6g} m from site "
            f"{solution.reference_site}; expected {MAX_FROM_SITE_M:,.0f} m at most"
        )
    if solution.frame == site_frame(solution.reference_site):
        raise VectorFileError(f"{source}: {solution.frame} refers to itself")


def _counter(element: ET.Element, source: str) -> tuple[int, ...]:
    counter: list[int] = []
    while len(counter) < MAX_COUNTERS and element.get(f"index{len(counter) + 1}") is not None:
        counter.append(_whole(element, f"index{len(counter) + 1}", source))
    return tuple(counter)


def _child(element: ET.Element, tag: str, source: str) -> ET.Element:
    child = element.find(tag)
    if child is None:
        raise VectorFileError(f"{source}: {_tag(element)} lacks <{tag}>")
    return child


def _attribute(element: ET.Element, name: str, source: str) -> str:
    value = element.get(name)
    if value is None:
        raise VectorFileError(f"{source}: {_tag(element)} lacks the attribute {name}")
    return value


def _whole(element: ET.Element, name: str, source: str) -> int:
    text = _attribute(element, name, source)
    if not re.fullmatch(r"\d{1,9}", text, re.ASCII):
        raise VectorFileError(
            f"{source}: {name} of {_tag(element)} should be a whole number, but is {text[:40]!a}"
        )
    return int(text)


def _numbers(element: ET.Element, names: Iterable[str], source: str) -> np.ndarray:
    values = []
    for name in names:
        text = _attribute(element, name, source)
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise VectorFileError(
                f"{source}: {name} of {_tag(element)} should be a number, but is {text[:40]!a}"
            )
        values.append(value)
    return np.array(values)


def _sigma(element: ET.Element, name: str, source: str) -> float | None:
    if element.get(name) is None:
        return None
    sigma = float(_numbers(element, [name], source)[0])
    if not sigma > 0:
        raise VectorFileError(f"{source}: {name} of {_tag(element)} should be above 0")
    return sigma


def _tag(element: ET.Element) -> str:
    index = "".join(f" {name}={element.get(name)}" for name in ("name", "index1", "index2")
                    if element.get(name) is not None)  # fmt: skip
    return f"<{element.tag[:40]}{index[:80]}>"


def _plain(value: float) -> str:
    return f"{value:.9f}"


def vector_text(file: VectorFile, number: Digits = _plain) -> str:
    """The XML of a vector file; `parse_vector_file` reads it back."""
    first = file.solutions[0]
    site = f' index1="{first.counter[0]}"' if file.kind == "rvf" else ""
    entries = "".join(f'  <entry solution_id="{name}"/>\n' for name in file.priority)
    solutions = "".join(_solution_text(one, number) for one in file.solutions)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<rmc_file mission="{file.mission}" variant="Master_{file.kind.upper()}"{site}>\n'
        f" <priority>\n{entries} </priority>\n{solutions}</rmc_file>\n"
    )


def _solution_text(one: Solution, number: Digits) -> str:
    index = " ".join(f'index{k}="{value}"' for k, value in enumerate(one.counter, 1))
    place = " ".join(f'{axis}="{number(v)}"' for axis, v in zip("xyz", one.offset_m, strict=True))
    turn = zip(("s", "v1", "v2", "v3"), one.quaternion, strict=True)
    attitude = " ".join(f'{axis}="{number(v)}"' for axis, v in turn)
    added = f'add_date="{one.added}" ' if one.added else ""
    sigmas = (("sigma_m", one.sigma_m), ("sigma_deg", one.sigma_deg))
    known = "".join(f'{name}="{value!r}" ' for name, value in sigmas if value is not None)
    head = f'solution_id="{one.solution_id}" name="{FRAME_NAMES[one.kind]}"'
    return (
        f" <solution {head} {added}{known}{index}>\n"
        f'  <reference_frame name="SITE_FRAME" index1="{one.reference_site}"/>\n'
        f"  <offset {place}/>\n  <orientation {attitude}/>\n </solution>\n"
    )
