"""Products of a store, opened for other programs: rasters by rasterio, vectors by geopandas."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from solmap.config.settings import Settings
from solmap.config.workspace import open_workspace
from solmap.photogrammetry.archive.missions import mission_id
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, ProductNotFoundError
from solmap.products.model import Layer, ProductKind, mission_of

if TYPE_CHECKING:
    import geopandas
    import rasterio


class Store:
    """A store of products, read only: the latest of each kind and place."""

    def __init__(self, workspace: Workspace) -> None:
        """As `open_store` opens it."""
        self.workspace = workspace

    def layers(
        self,
        kind: str | None = None,
        *,
        sol: int | None = None,
        stop: str | None = None,
        mission: str | None = None,
    ) -> list[Layer]:
        """What is on the map, by stop; all, or of a kind, sol, stop (`10/100`) or mission.

        Raises:
            ProductError: there is no such kind of products.
        """
        if kind is not None and kind not in {str(one) for one in ProductKind}:
            raise ProductError(f"there is no kind {kind!r}; `solmap products` lists what there is")
        place = "" if stop is None else "-site{:04d}-drive{:04d}".format(*map(int, stop.split("/")))
        requested = None if mission is None else mission_id(mission)
        return [
            layer
            for layer in self.workspace.catalogue.layers()
            if (kind is None or layer.ref.kind == kind)
            and (sol is None or sol in layer.sols)
            and layer.ref.scope.name.endswith(place)
            and (
                requested is None
                or requested in {layer.mission, mission_id(mission_of(layer.mission))}
            )
        ]

    def path(
        self,
        kind: str,
        *,
        sol: int | None = None,
        stop: str | None = None,
        mission: str | None = None,
    ) -> Path:
        """The file of a product; of several stops that match, that of the last.

        Raises:
            ProductError: there is no such kind of products, or no such product.
        """
        found = self.layers(kind, sol=sol, stop=stop, mission=mission)
        if not found:
            where = {"sol": sol, "stop": stop, "mission": mission}
            named = "".join(
                f", {name} {value}" for name, value in where.items() if value is not None
            )
            raise ProductNotFoundError(f"no {kind} is in the store{named}; run that downlink first")
        newest = max(found, key=lambda layer: (max(layer.sols), layer.ref.scope.name))
        return self.workspace.store.path(newest.ref)

    def latest(
        self,
        kind: str,
        *,
        sol: int | None = None,
        stop: str | None = None,
        mission: str | None = None,
    ) -> rasterio.DatasetReader:
        """A raster, opened; `with store.latest("dtm", sol=156) as dtm: dtm.read(1)`.

        Raises:
            ProductError: as `path`.
            RasterioIOError: it is not a raster; `features` opens layers of vectors.
        """
        import rasterio  # noqa: PLC0415 - slow to import

        return rasterio.open(self.path(kind, sol=sol, stop=stop, mission=mission))

    def features(
        self,
        kind: str,
        *,
        sol: int | None = None,
        stop: str | None = None,
        mission: str | None = None,
    ) -> geopandas.GeoDataFrame:
        """A layer of vectors: contours, traverse, stops, footprints, tie-points ...

        Raises:
            ProductError: as `path`.
        """
        import geopandas  # noqa: PLC0415 - slow to import

        return geopandas.read_file(self.path(kind, sol=sol, stop=stop, mission=mission))

    def positions(self) -> list[dict[str, Any]]:
        """Telemetry and adjusted position of every stop, as `solmap positions --json` prints it."""
        from solmap.flows.cli.tables import position_rows  # noqa: PLC0415 - for this alone

        return position_rows(self.workspace)


def open_store(path: str | Path | None = None) -> Store:
    """The store in a folder; that of the settings if none is named.

    Raises:
        ProductNotFoundError: there is none.
    """
    root = Path(path) if path is not None else Settings().store
    if not (root / "catalogue.sqlite").exists() and not (root / "drafts").exists():
        raise ProductNotFoundError(
            f"{root} is not a store; `solmap run DOWNLINK --store {root}` makes one"
        )
    return Store(open_workspace(root))
