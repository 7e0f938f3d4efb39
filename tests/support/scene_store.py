"""The bowl in three dimensions: a store with 3D tiles, an adjusted network and labelled images.

Every stop stands level on the bowl; the rover heads north at the first stop and 30 degrees further
to the east at each of the next. The last stop has a pair of images, with labels as flown.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustedStop,
    AdjustedTies,
    AdjustmentReport,
)
from solmap.photogrammetry.frames import LSL, Pose, rotation_of_roll_pitch_yaw, site_frame
from solmap.photogrammetry.imagery import Eye, StopId, TiePoints
from solmap.photogrammetry.synthetic.edr import Exposure, edr_bytes
from solmap.photogrammetry.synthetic.lighting import Sun
from solmap.photogrammetry.synthetic.rig import CAMERAS, Instrument, Pointing
from solmap.photogrammetry.terrain.dtm.region_dtm import RegionParams
from solmap.photogrammetry.terrain.mesh.point_cloud import PointCloud, cloud_tiles
from solmap.photogrammetry.terrain.mesh.surface_mesh import ModelParams, TilesetParams
from solmap.photogrammetry.terrain.orthophoto.merging import MergingParams
from solmap.products.catalogue.catalogue import ImageEntry, MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.adjusted_network import network_document
from solmap.products.formats.documents.archives import pose_document
from solmap.products.formats.mesh.gltf import write_points
from solmap.products.formats.mesh.models import extent_of_model
from solmap.products.formats.mesh.tiles3d import TilesetWriter
from solmap.products.formats.raster.orthophoto import write_orthophoto
from solmap.products.formats.raster.raster import write_dtm
from solmap.products.formats.raster.region import RegionFiles, RegionSource, write_region
from solmap.products.formats.raster.region_orthophoto import write_region_orthophoto
from solmap.products.formats.vector.geojson import Feature
from solmap.products.model import Layer, ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from tests.support.bowl_store import (
    CRS,
    GRID,
    LANDING,
    STOPS,
    Shop,
    chequers,
    dtm,
    elevation_at,
    stop_features,
)

ABOVE_GROUND_M = 0.294
POINTING = Pointing(math.radians(20.0), math.radians(-25.0))
SOL = 156
SEMI_AXES_M = (0.3, 0.2, 0.1)
"""North, east and down deviations of stops that the datum does not hold."""
LAST = STOPS[-1][0]


def stop_id(index: int) -> StopId:
    _, site, drive, *_ = STOPS[index]
    return StopId("MER2", site, drive)


def heading(index: int) -> float:
    return math.radians(30.0 * index)


def place_of(index: int) -> tuple[float, float, float]:
    """(east, north, up) of the rover's origin."""
    east, north = STOPS[index][3]
    return east, north, elevation_at(east, north) + ABOVE_GROUND_M


def lsl_from_rover(index: int, moved: tuple[float, float] = (0.0, 0.0)) -> Pose:
    east, north, up = place_of(index)
    place = np.array([north + moved[1], east + moved[0], -up])
    turn = rotation_of_roll_pitch_yaw(0.0, 0.0, heading(index))
    return Pose(LSL, stop_id(index).frame, turn, place)


def network() -> AdjustedNetwork:
    nothing = np.zeros(0)
    empty = TiePoints((), *(np.zeros(0, dtype=np.int32),) * 2, np.zeros((0, 2)), *(nothing,) * 4)
    numbers = np.zeros(0, dtype=np.int32), *(np.zeros((0, 3)),) * 3
    ties = AdjustedTies(empty, np.zeros((0, 3)), np.zeros((0, 3, 3)), (), *numbers)
    stops = []
    for index in range(len(STOPS)):
        deviations = np.zeros(6) if index == 0 else np.array([0.001] * 3 + list(SEMI_AXES_M))
        stops.append(
            AdjustedStop(
                stop_id(index),
                lsl_from_rover(index),
                np.diag(deviations**2),
                held=index == 0,
                is_tied=True,
                held_by="a test",
            )
        )
    return AdjustedNetwork(tuple(stops), (), ties)


def exposure(eye: Eye) -> Exposure:
    """An image of the last stop, four pixels averaged to one."""
    index = len(STOPS) - 1
    stop = stop_id(index)
    level = Pose(
        site_frame(stop.site),
        stop.frame,
        rotation_of_roll_pitch_yaw(0.0, 0.0, heading(index)),
        np.zeros(3),
    )
    in_mast = CAMERAS[Instrument.NAVCAM, eye].in_mast.average(4, 4, correct_half_pixel=False)
    return Exposure(
        stop=stop,
        sol=SOL,
        local_solar_hour=12.0,
        solar_longitude=1.0,
        sun=Sun(math.radians(315.0), math.radians(45.0)),
        site_from_rover=level,
        instrument=Instrument.NAVCAM,
        eye=eye,
        pointing=POINTING,
        camera=in_mast.transform(POINTING.rover_from_mast(stop)),
        clock=140_200_000,
        pma=1,
        sequence="P1600",
        averaging=4,
    )


def png(eye: Eye) -> np.ndarray:
    """Vertical bars, 8 pixels to the left in the right image: parallax 8 everywhere."""
    sample = np.arange(256) + (8 if eye is Eye.RIGHT else 0)
    bars = 120 + 80 * np.sign(np.sin(sample / 256 * 2 * math.pi * 7.3))
    return np.tile(bars, (256, 1))


def fill_scene(workspace: Workspace) -> None:
    shop = Shop(workspace)
    shop.raster(ProductKind.DTM, lambda path: write_dtm(path, dtm(), CRS))
    shop.raster(ProductKind.ORTHOPHOTO, _orthophoto)
    shop.vectors(ProductKind.STOPS, list(stop_features()))
    shop.vectors(ProductKind.TIE_POINTS, [_tie(k) for k in range(40)])
    fill_network(workspace)
    _publish_models(workspace)
    _publish_points(workspace)


def fill_network(workspace: Workspace) -> None:
    """Only the mission, its network and the images of the last stop."""
    workspace.catalogue.publish(missions=[MissionEntry("MER2", "Spirit", LANDING, None)])
    _publish_network(workspace)
    _publish_images(workspace)


def _orthophoto(path, picture=None) -> None:
    brightness = chequers() if picture is None else picture
    write_orthophoto(path, GRID, brightness, CRS, stretch=(0.0, 254.0))


def _tie(number: int) -> Feature:
    turn = 2 * math.pi * number / 40
    east, north = 10 * math.sin(turn), 10 * math.cos(turn)
    at = np.array([[east, north, elevation_at(east, north)]])
    return Feature("Point", at, {"kind": "inter-stereo", "residual_px": 0.1}, str(number))


def _publish_network(workspace: Workspace) -> None:
    stood = AdjustmentReport(
        "the bowl",
        converged=True,
        iterations=0,
        sigma0=1.0,
        redundancy=0,
        stops=len(STOPS),
        pairs=0,
    )
    document = {
        "mission": "MER2",
        "sol": SOL,
        "stops": [
            {
                "mission": "MER2",
                "site": site,
                "drive": drive,
                "sols": [155],
                "telemetry": pose_document(
                    lsl_from_rover(k, (telemetry[0] - at[0], telemetry[1] - at[1]))
                ),
            }
            for k, (_, site, drive, at, telemetry) in enumerate(STOPS)
        ],
        "network": network_document(network(), [stood]),
        "reports": [],
        "links": [],
    }
    recipe = Recipe(ProductKind.NETWORK, Scope(ScopeLevel.SOL, f"mer2-sol{SOL:04d}"))
    ref = workspace.store.make(recipe, lambda path: path.write_text(json.dumps(document)))
    workspace.catalogue.publish(pointers=[ref])


def _publish_images(workspace: Workspace) -> None:
    names = {eye: exposure(eye).product_id for eye in (Eye.LEFT, Eye.RIGHT)}
    for eye, name in names.items():
        scope = Scope(ScopeLevel.IMAGE, name.lower())
        grey = png(eye)
        pixels = (grey * 8).astype(np.int32)
        body = cv2.imencode(".png", grey.astype(np.uint8))[1].tobytes()
        made = [
            workspace.store.make(Recipe(kind, scope), lambda path, data=data: _keep(path, data))
            for kind, data in (
                (ProductKind.IMAGE, edr_bytes(exposure(eye), pixels)),
                (ProductKind.BROWSE, body),
            )
        ]
        stop = stop_id(len(STOPS) - 1)
        other = names[Eye.RIGHT if eye is Eye.LEFT else Eye.LEFT]
        entry = ImageEntry(
            id=name,
            mission="MER2",
            stop=str(stop),
            site=stop.site,
            drive=stop.drive,
            sol=SOL,
            instrument="NAVCAM",
            eye=str(eye),
            product_type="EDN",
            start_time=None,
            local_solar_time=None,
            partner=other,
            unpaired_because=None,
            ref=made[0],
            browse=made[1],
        )
        workspace.catalogue.publish(images=[entry])


def _keep(path, data: bytes) -> None:
    path.write_bytes(data)


def _publish_models(
    workspace: Workspace, stop: str = LAST, raised_m: float = 0.0, picture=None
) -> tuple[ProductRef, ProductRef]:
    """Tiles and model of the bowl as a stop sees it; its terrain model and orthophoto."""
    from solmap.tasks.maps.models import model_terrain  # noqa: PLC0415 - slow to import

    store, scope = workspace.store, Scope(ScopeLevel.STOP, stop)
    seen = replace(dtm(), elevation=dtm().elevation + np.float32(raised_m))
    ground = store.make(Recipe(ProductKind.DTM, scope), lambda path: write_dtm(path, seen, CRS))
    image = store.make(
        Recipe(ProductKind.ORTHOPHOTO, scope), lambda path: _orthophoto(path, picture)
    )
    model, tiling = ModelParams(max_texture_px=1024), TilesetParams(texture_px=512, draco=True)
    for ref in model_terrain.fn(ground, image, model, tiling, LANDING, store):
        workspace.catalogue.publish(layers=[_layer(ref, workspace)])
    return ground, image


RAISED_M = 1.0
"""The first stop sees the bowl so much higher than the last one."""
DARKENED = 0.7
"""The first stop sees it darker, with the dark squares where the last one sees the bright ones."""


def fill_overlapping_scene(workspace: Workspace) -> None:
    """The scene with two stops that see the same ground, and the maps that merge them."""
    fill_scene(workspace)
    shop = Shop(workspace)
    places = {name: at for name, _, _, at, _ in STOPS}
    seen = {
        name: _publish_models(workspace, name, *how)
        for name, how in ((STOPS[0][0], (RAISED_M, DARKENED * (260 - chequers()))), (LAST, ()))
    }
    for ref in (ref for refs in seen.values() for ref in refs):
        shop.show(ref)
    terrains, orthophotos = (
        [
            RegionSource(name, places[name], workspace.store.path(refs[kind]))
            for name, refs in seen.items()
        ]
        for kind in (0, 1)
    )

    def write(path: Path) -> None:
        seams = path.with_suffix(".seams.tif")
        write_region(RegionFiles(path, seams), terrains, RegionParams(), CRS)
        seams.unlink()

    shop.raster(ProductKind.REGION_DTM, write)
    shop.raster(
        ProductKind.REGION_ORTHOPHOTO,
        lambda path: write_region_orthophoto(path, orthophotos, MergingParams(), CRS),
    )


POINTS = 6_000
POINT_GREYS = (60, 220)
"""Of points in the west and in the east."""


def _publish_points(workspace: Workspace) -> None:
    """Points on the bowl, dark in the west and bright in the east."""
    rng = np.random.default_rng(8)
    turn, reach = rng.uniform(0, 2 * np.pi, POINTS), 36 * np.sqrt(rng.uniform(0, 1, POINTS))
    east, north = reach * np.sin(turn), reach * np.cos(turn)
    places = np.column_stack([east, north, elevation_at(east, north)])
    grey = np.where(east > 0, POINT_GREYS[1], POINT_GREYS[0]).astype(np.uint8)
    cloud = PointCloud(places, grey, np.full(POINTS, 0.01, np.float32), 0.1)

    def write(path) -> None:
        with TilesetWriter(path, {}, refine="ADD") as writer:
            for tile in cloud_tiles(cloud):
                glb = write_points(tile.cloud)
                writer.add(tile.place, glb, tile.cloud.points, 5 * tile.spacing_m)

    recipe = Recipe(ProductKind.POINT_TILES, Scope(ScopeLevel.STOP, LAST))
    ref = workspace.store.make(recipe, write)
    workspace.catalogue.publish(layers=[_layer(ref, workspace)])


def _layer(ref: ProductRef, workspace: Workspace) -> Layer:
    bounds, values = extent_of_model(workspace.store.path(ref))
    made_at = workspace.store.made_at(ref)
    return Layer(ref, "MER2", str(ref.kind), "model", bounds, None, "m", values, (SOL,), made_at)
