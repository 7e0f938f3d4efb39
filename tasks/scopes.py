"""Names of what products are about."""

from __future__ import annotations

from photogrammetry.adjustment.modes import AdjustmentMode
from photogrammetry.imagery import StopId
from products.model import Scope, ScopeLevel


def image_scope(image_id: str) -> Scope:
    """One image."""
    return Scope(ScopeLevel.IMAGE, image_id.lower())


def pair_scope(pair_id: str) -> Scope:
    """One stereo pair, named by its left image."""
    return Scope(ScopeLevel.PAIR, pair_id.lower())


def stop_scope(stop: StopId) -> Scope:
    """One stop: `mer2-site0010-drive0064`."""
    return Scope(ScopeLevel.STOP, str(stop))


def sol_scope(mission: str, sol: int) -> Scope:
    """One sol: `mer2-sol0156`."""
    return Scope(ScopeLevel.SOL, f"{mission.lower()}-sol{sol:04d}")


def network_scope(mission: str, sol: int, mode: AdjustmentMode) -> Scope:
    """The network of a sol; after the sol's own comes that of an overall adjustment up to it.

    In this order their names sort: `mer2-sol0156`, `mer2-sol0156-overall`, `mer2-sol0157`.
    """
    of_sol = sol_scope(mission, sol)
    if mode is AdjustmentMode.OVERALL:
        return Scope(of_sol.level, f"{of_sol.name}-{mode}")
    return of_sol


def region_scope(mission: str) -> Scope:
    """Everything a mission has mapped."""
    return Scope(ScopeLevel.REGION, mission.lower())
