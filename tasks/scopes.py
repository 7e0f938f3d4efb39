"""Names of scopes, the subjects of products."""

from __future__ import annotations

from solmap.photogrammetry.adjustment.model.params import AdjustmentMode
from solmap.photogrammetry.imagery import StopId
from solmap.products.errors import ProductError, one_line
from solmap.products.model import Scope, ScopeLevel, mission_of

_MAX_NAME_BYTES = 200
OVERALL = f"-{AdjustmentMode.OVERALL}"
"""Suffix of the names of overall adjustments."""


def image_scope(image_id: str) -> Scope:
    """One image."""
    return Scope(ScopeLevel.IMAGE, image_id.lower())


def pair_scope(pair_id: str) -> Scope:
    """One stereo pair, named by its left image."""
    return Scope(ScopeLevel.PAIR, pair_id.lower())


def stop_scope(stop: StopId) -> Scope:
    """One stop: `mer2-site0010-drive0064`."""
    return Scope(ScopeLevel.STOP, str(stop))


def stop_of(scope: Scope, mission: str) -> StopId:
    """The stop of a mission, or on one of its maps, of a scope of `stop_scope`."""
    site, drive = scope.name.rpartition("-site")[2].split("-drive")
    return StopId(mission_of(mission), int(site), int(drive))


def sol_scope(mission: str, sol: int) -> Scope:
    """One sol on a map: `mer2-sol0156`, `mer2-origin137-sol1902`."""
    return Scope(ScopeLevel.SOL, f"{mission.lower()}-sol{sol:04d}")


def network_scope(mission: str, sol: int, mode: AdjustmentMode) -> Scope:
    """The network of a sol; an overall adjustment up to it follows the sol's own.

    Their names sort in this order: `mer2-sol0156`, `mer2-sol0156-overall`, `mer2-sol0157`.
    """
    of_sol = sol_scope(mission, sol)
    if mode is AdjustmentMode.OVERALL:
        return Scope(of_sol.level, of_sol.name + OVERALL)
    return of_sol


def is_of_mission(network: Scope, mission: str) -> bool:
    """Whether a scope is one of `network_scope` for a mission."""
    return network.name.startswith(f"{mission.lower()}-sol")


def is_overall(network: Scope) -> bool:
    """Whether a scope of `network_scope` is of an overall adjustment."""
    return network.name.endswith(OVERALL)


def sol_of(network: Scope) -> int:
    """The sol of a scope of `network_scope`."""
    return int(network.name.removesuffix(OVERALL).rpartition("-sol")[2])


def file_scope(name: str) -> Scope:
    """One file that concerns more than one image, by its name.

    Raises:
        ProductError: the name cannot be used for a product.
    """
    if not name.isprintable() or "\\" in name or len(name.encode()) > _MAX_NAME_BYTES:
        raise ProductError(
            f"{one_line(name)[:60]}: rename it; names of stored files may have up to "
            f"{_MAX_NAME_BYTES} bytes, all printable and no backslash"
        )
    return Scope(ScopeLevel.REGION, name.lower().replace(".", "-"))


def region_scope(mission: str) -> Scope:
    """The whole mapped region of a mission."""
    return Scope(ScopeLevel.REGION, mission.lower())


def part_scope(mission: str, first: Scope) -> Scope:
    """A region that begins with a stop: `mer2-region-site0010-drive0064`."""
    first_stop = first.name.removeprefix(f"{mission_of(mission).lower()}-")
    return Scope(ScopeLevel.REGION, f"{mission.lower()}-region-{first_stop}")
