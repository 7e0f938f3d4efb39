"""What earlier runs published and the sols of a mission no longer give.

Images that come late change which stops are linked and which images make pairs: then a stop may
have no far ground any more, and an image no partner. The sols of a run, those that it passed over
included, are all there is to be shown of stops; what else is there would depend on the order in
which files came.
"""

from __future__ import annotations

from collections.abc import Sequence, Set

from solmap.flows.finished import is_finished
from solmap.flows.sol_inputs import SolReport
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import LEVEL, ProductKind, ProductRef, Scope, ScopeLevel
from solmap.tasks.publish import withdraw
from solmap.tasks.scopes import is_of_mission, pair_scope

BY_COMMAND = {ProductKind.DIPS}
"""Layers of stops that people have made too, by commands of their own."""

Latest = Set[tuple[ProductKind, Scope]]


def withdraw_leftovers(mission: str, sols: Sequence[SolReport], workspace: Workspace) -> None:
    """Withdraw what none of the sols published; `sols` are all of the mission.

    Where one failed in a way that may pass, everything stays: what it published was good, and the
    next run will tell.
    """
    if not sols or not all(map(is_finished, sols)):
        return
    given = {(ref.kind, ref.scope) for sol in sols for ref in (*sol.published, *sol.pointed)}
    layers = [
        layer
        for layer in workspace.catalogue.layers(mission)
        if layer.ref.scope.level is ScopeLevel.STOP
        and layer.ref.kind not in BY_COMMAND
        and (layer.ref.kind, layer.ref.scope) not in given
    ]
    pointers = _pointers(mission, given, workspace)
    if layers or pointers:
        withdraw(workspace.catalogue.mission(mission), layers, pointers, workspace)


def _pointers(mission: str, given: Latest, workspace: Workspace) -> list[ProductRef]:
    """Of pairs, stops and sols, what the catalogue points at and no sol gave."""
    images = workspace.catalogue.images(mission)
    pairs = {pair_scope(image.id) for image in images}
    stops = {image.stop for image in images}
    levels = {ScopeLevel.PAIR, ScopeLevel.STOP, ScopeLevel.SOL}
    return [
        ref
        for kind in ProductKind
        if LEVEL.get(kind) in levels
        for ref in workspace.catalogue.pointers(kind)
        if (ref.kind, ref.scope) not in given
        and (ref.scope in pairs or ref.scope.name in stops or is_of_mission(ref.scope, mission))
    ]
