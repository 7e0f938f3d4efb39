"""What matching and tying would have made of a simulated mission, sol by sol and without pixels.

Matches, ties and links are written under the same recipes as the stages of a sol use, so that these
find them made and continue with the adjustment.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StereoMatches, StopId, TiePoints
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.synthetic.edr import Exposure
from solmap.photogrammetry.synthetic.mission import (
    MissionPlan,
    SimulatedMission,
    exposures,
    mission_names,
    simulate_mission,
)
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.archives import (
    pose_document,
    write_archive,
    write_matches,
    write_ties,
)
from solmap.products.formats.documents.rig import PairRows, write_pair_rows
from solmap.products.model import ProductKind, ProductRef, Recipe

FEWEST = 5
"""Ties between two stops below which they are not linked."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighted:
    """The tie points of a mission, separated by where they are seen from."""

    alone: dict[str, np.ndarray]
    """Rows of points that one pair alone sees, by pair."""
    within: dict[StopId, np.ndarray]
    """Couples of rows of points that two pairs of one stop see."""
    across: dict[tuple[StopId, StopId], np.ndarray]
    """Couples of rows of points that two stops see, the earlier one first."""

    @classmethod
    def of(cls, mission: SimulatedMission) -> Sighted:
        """Sort the observations of a mission."""
        ties, stop_of = mission.network.ties, [pair.stop for pair in mission.network.pairs]
        order = np.argsort(ties.point, kind="stable")
        groups = np.split(order, np.flatnonzero(np.diff(ties.point[order])) + 1)
        alone: dict[str, list[int]] = {}
        within: dict[StopId, list[tuple[int, int]]] = {}
        across: dict[tuple[StopId, StopId], list[tuple[int, int]]] = {}
        for rows in groups:
            if len(rows) == 1:
                alone.setdefault(ties.pair_ids[ties.pair[rows[0]]], []).append(int(rows[0]))
                continue
            a, b = sorted(rows[:2].tolist(), key=lambda row: int(ties.pair[row]))
            one, other = stop_of[ties.pair[a]], stop_of[ties.pair[b]]
            couples = within.setdefault(one, []) if one == other else None
            (across.setdefault((one, other), []) if couples is None else couples).append((a, b))
        return cls(
            {pair: np.array(rows) for pair, rows in alone.items()},
            {stop: np.array(rows) for stop, rows in within.items()},
            {stops: np.array(rows) for stops, rows in across.items()},
        )


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedSols:
    """A mission whose sols can be delivered one after the other."""

    mission: SimulatedMission
    plan: MissionPlan
    seen: Sighted
    exposures: tuple[tuple[Exposure, Exposure], ...]
    """Of all pairs, in the order of the traverse."""
    made: dict[StopId, Any] = field(default_factory=dict)
    """What was made of the stops so far, for the links of those to come."""

    @classmethod
    def of(cls, stops: int, seed: int = 1, spacing_m: float = 14.0, **ties: int) -> SimulatedSols:
        """A number of stops of the mission that the defaults describe, one stop per sol.

        Args:
            stops: How many.
            seed: Of all that is random.
            spacing_m: From stop to stop.
            ties: Counts of the plan that differ from the defaults: `pairs_per_stop`, `inter_ties`.
        """
        length_m = spacing_m * stops
        plan = MissionPlan(
            stops=stops, distance_m=length_m, gaps=stops // 50, control_every=0, **ties
        )
        names = mission_names(plan)
        mission = simulate_mission(np.random.default_rng(seed), plan, names=names)
        return cls(mission, plan, Sighted.of(mission), tuple(exposures(mission, plan)))

    def deliver(self, sols: Sequence[int], workspace: Workspace) -> None:
        """Enter the images of some sols in the catalogue, as ingesting does."""
        from solmap.tasks.mission.simulation import _entry, _placeholder_image  # noqa: PLC0415 - brings the engine

        browse, entries = _placeholder_image(workspace), []
        for left, right in self.exposures:
            if left.sol in sols:
                entries += [
                    _entry(left, right.product_id, browse, workspace),
                    _entry(right, left.product_id, browse, workspace),
                ]
        workspace.catalogue.publish(images=entries)

    def match(self, inputs: Any) -> None:
        """Make all that matching and tying would make of the new stops of a sol."""
        _Maker(self, inputs).make()


@dataclass(frozen=True, slots=True, eq=False)
class _Maker:
    """Writes the products of one sol."""

    sols: SimulatedSols
    inputs: Any

    def make(self) -> None:
        """Matches of the new pairs, ties of their stops, links to those before."""
        from solmap.flows.sol_network import _link_candidates, parts_at  # noqa: PLC0415 - brings the engine
        from solmap.tasks.images.pairs import pairs_of  # noqa: PLC0415
        from solmap.tasks.network.tie import StopProducts, link_poses  # noqa: PLC0415

        inputs, store = self.inputs, self.inputs.workspace.store
        window, stops = {stop.stop: stop for stop in inputs.window}, self.sols.made
        for name in [stop for stop in window if stop not in stops]:
            pairs = pairs_of(inputs.workspace.catalogue.images(stop=str(name)))
            stop = StopProducts(name, tuple(map(self._matched, pairs)))
            rows = self.sols.seen.within.get(name, np.zeros((0, 2), dtype=int))
            header = {"stop": str(name), "links": [], "rms_px": 0.3}
            recipe = Recipe(
                ProductKind.TIES, _stop_scope(name), stop.inputs, inputs.config.inter_stereo
            )
            ties = store.make(recipe, lambda p, r=rows, h=header: self._write(p, r, h))
            self._keep_preview(ties)
            stops[name] = replace(stop, ties=ties)
        links = {
            (old, new): self._linked(stops[old], stops[new], window[old], window[new])
            for old, new in _link_candidates(inputs)
        }
        for new in inputs.new_stops:
            for one, other in parts_at(window[new], inputs, stops, link_poses(links, store)):
                self._linked(one, other, window[one.stop], window[other.stop])

    def _matched(self, pair: Any) -> Any:
        from solmap.tasks.images.pairs import PairProducts  # noqa: PLC0415
        from solmap.tasks.network.match import MatchParams  # noqa: PLC0415 - brings the engine
        from solmap.tasks.scopes import pair_scope  # noqa: PLC0415

        config, store = self.inputs.config, self.inputs.workspace.store
        params = MatchParams(config.sparse, config.dense)
        (known,) = (p for p in _pairs_at(self.sols, pair.stop) if p.pair_id == pair.id)
        ties = self.sols.mission.network.ties
        at = self.sols.seen.alone.get(pair.id, np.zeros(0, dtype=int))
        matches = StereoMatches(pair.id, ties.left[at], ties.parallax_px[at], ties.sigma_px[at])
        rows = PairRows(pair.id, str(pair.stop), pair.instrument, "no images", np.eye(3), None)
        unseen = Recipe(ProductKind.VERTICAL_PARALLAX, pair_scope(pair.id), pair.inputs)
        store.make(unseen, lambda p: write_pair_rows(p, rows))
        sparse = Recipe(ProductKind.MATCHES, pair_scope(pair.id), pair.inputs, params.sparse)
        dense = Recipe(ProductKind.PARALLAX, pair_scope(pair.id), pair.inputs, params.dense)
        products = PairProducts(
            pair,
            store.make(sparse, lambda p: write_matches(p, known.geometry, matches)),
            store.make(dense, lambda p: write_archive(p, {"step_px": 1.0})),
        )
        preview = Recipe(ProductKind.QUICKLOOK, pair_scope(pair.id), products.made, config.sparse)
        store.make(preview, lambda p: p.write_bytes(b"none"))
        return products

    def _linked(self, earlier: Any, later: Any, *telemetry: Any) -> ProductRef:
        from solmap.tasks.network.tie import links_recipe  # noqa: PLC0415 - brings the engine

        rows = self.sols.seen.across.get((earlier.stop, later.stop), np.zeros((0, 2), dtype=int))
        is_linked = len(rows) >= FEWEST
        header = {
            "earlier": str(earlier.stop),
            "later": str(later.stop),
            "linked": is_linked,
            "reason": f"{len(rows)} ties",
            "earlier_from_later": pose_document(Pose.identity(*(_frames(earlier, later)))),
            "figures": {},
        }
        recipe = links_recipe(earlier, later, *telemetry, self.inputs.config.cross_site)
        kept = rows if is_linked else rows[:0]
        links = self.inputs.workspace.store.make(recipe, lambda p: self._write(p, kept, header))
        self._keep_preview(links)
        return links

    def _keep_preview(self, ref: ProductRef) -> None:
        recipe = Recipe(ProductKind.QUICKLOOK, ref.scope, (ref,))
        self.inputs.workspace.store.make(recipe, lambda p: p.write_bytes(b"none"))

    def _write(self, path: Any, couples: np.ndarray, header: dict[str, Any]) -> None:
        write_ties(path, _ties_of(self.sols.mission.network.ties, couples), header)


def _stop_scope(stop: StopId) -> Any:
    from solmap.tasks.scopes import stop_scope  # noqa: PLC0415

    return stop_scope(stop)


def _frames(earlier: Any, later: Any) -> tuple[Any, Any]:
    return earlier.stop.frame, later.stop.frame


def _pairs_at(sols: SimulatedSols, stop: StopId) -> Iterable[Any]:
    n, first = sols.plan.pairs_per_stop, stop.drive // 2
    return sols.mission.network.pairs[n * first : n * first + n]


def _columns(ties: TiePoints, rows: np.ndarray) -> Iterator[np.ndarray]:
    for name in ("left", "parallax_px", "sigma_px", "sigma_parallax_px", "sigma_line_px"):
        yield getattr(ties, name)[rows]


def _ties_of(ties: TiePoints, couples: np.ndarray) -> Ties:
    """Couples of observations as ties between pairs."""
    first, second = couples.reshape(-1, 2).T
    both = zip(_columns(ties, first), _columns(ties, second), strict=True)
    used = sorted({*ties.pair[first].tolist(), *ties.pair[second].tolist()})
    number = {pair: k for k, pair in enumerate(used)}
    numbers = [
        np.array([number[pair] for pair in ties.pair[rows].tolist()], dtype=np.int32)
        for rows in (first, second)
    ]
    columns = [column for couple in both for column in couple]
    return Ties(tuple(ties.pair_ids[pair] for pair in used), *numbers, *columns)
