"""The pipeline's parameters: one TOML table per stage, mirrored by the stages' own records.

A pipeline file contains only differences from the defaults, which are defined beside their
algorithms; the error of an unknown key names the key. `solmap run --pipeline` takes the name of a
shipped file (`config/pipelines/`) or a path.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from solmap.config.records import ConfigError, faults_of, read_toml, record_of
from solmap.config.settings import PIPELINES
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode, AdjustmentParams
from solmap.photogrammetry.adjustment.quality.movement import ReissueParams
from solmap.photogrammetry.adjustment.quality.records import QualityParams
from solmap.photogrammetry.matching.cross_site.gate import LinkParams
from solmap.photogrammetry.matching.cross_site.linking import CrossSiteParams
from solmap.photogrammetry.matching.inter_stereo import InterStereoParams
from solmap.photogrammetry.matching.single.search import MonoParams
from solmap.photogrammetry.matching.stereo.dense import DenseParams
from solmap.photogrammetry.matching.stereo.sparse import SparseParams
from solmap.photogrammetry.matching.stereo.wide_baseline import WideParams
from solmap.photogrammetry.matching.tracks import TrackParams
from solmap.photogrammetry.terrain.dtm.region_dtm import RegionParams
from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams, FarDtmParams
from solmap.photogrammetry.terrain.insolation.maps import HavenParams, InsolationParams
from solmap.photogrammetry.terrain.measure.facets import FacetParams
from solmap.photogrammetry.terrain.mesh.point_cloud import PointCloudParams
from solmap.photogrammetry.terrain.mesh.surface_mesh import ModelParams, TilesetParams
from solmap.photogrammetry.terrain.mesh.view_mesh import ViewModelParams
from solmap.photogrammetry.terrain.orthophoto.merging import MergingParams
from solmap.photogrammetry.terrain.orthophoto.panorama import PanoramaParams
from solmap.photogrammetry.terrain.orthophoto.rendering import OrthophotoParams
from solmap.photogrammetry.terrain.relief.contours import (
    ContourParams,
    FarContourParams,
    RegionContourParams,
)
from solmap.photogrammetry.terrain.relief.slope import HillshadeParams, SlopeParams
from solmap.photogrammetry.terrain.traversability.hazard import HazardParams
from solmap.photogrammetry.terrain.visibility.footprints import FootprintParams
from solmap.photogrammetry.terrain.visibility.viewshed import ViewshedParams


@dataclass(frozen=True, slots=True)
class FarGround:
    """Whether two linked stops are used for wide-baseline stereo, and how."""

    enabled: bool = True
    """Whether far ground is mapped: two linked panoramas take about four seconds of processor
    time."""
    matching: WideParams = field(default_factory=WideParams)
    dtm: FarDtmParams = field(default_factory=FarDtmParams)
    contour: FarContourParams = field(default_factory=FarContourParams)


@dataclass(frozen=True, slots=True)
class Models:
    """Three-dimensional models of a stop, and their parameters."""

    of_terrain: bool = True
    """The terrain model with its orthophoto: one glTF, and 3D Tiles."""
    of_views: bool = True
    """The views of the pairs, with their own images: rocks and outcrops from all photographed
    sides."""
    of_points: bool = True
    """The dense stereo points: one PLY, and 3D Tiles."""
    dips_of_facets: bool = False
    """Strike and dip of planar facets. Off: few stops need it (`solmap dip rocks`)."""
    terrain: ModelParams = field(default_factory=ModelParams)
    tiles: TilesetParams = field(default_factory=TilesetParams)
    views: ViewModelParams = field(default_factory=ViewModelParams)
    points: PointCloudParams = field(default_factory=PointCloudParams)
    facets: FacetParams = field(default_factory=FacetParams)


@dataclass(frozen=True, slots=True)
class Panoramas:
    """Panoramas of stops."""

    enabled: bool = True
    """Whether panoramas are made."""
    drawing: PanoramaParams = field(default_factory=PanoramaParams)


@dataclass(frozen=True, slots=True)
class Region:
    """Whether the stops of a mission are mapped together as well, and how."""

    enabled: bool = True
    """Whether merged maps are made."""
    fusion: RegionParams = field(default_factory=RegionParams)
    orthophoto: MergingParams = field(default_factory=MergingParams)
    contour: RegionContourParams = field(default_factory=RegionContourParams)


@dataclass(frozen=True, slots=True)
class PipelineConfig:
    """Everything that may be tuned, stage by stage."""

    adjustment_mode: AdjustmentMode = AdjustmentMode.SEQUENTIAL
    """How the sols of a mission are adjusted: set before the first table of the file."""
    previews: bool = True
    """Whether to draw previews of matches, ties, links and terrain below `quicklook/`: set before
    the first table. They take a twentieth of a run; a later run with them draws those of all
    products."""
    sparse: SparseParams = field(default_factory=SparseParams)
    dense: DenseParams = field(default_factory=DenseParams)
    inter_stereo: InterStereoParams = field(default_factory=InterStereoParams)
    mono: MonoParams = field(default_factory=MonoParams)
    cross_site: CrossSiteParams = field(default_factory=CrossSiteParams)
    links: LinkParams = field(default_factory=LinkParams)
    tracks: TrackParams = field(default_factory=TrackParams)
    adjustment: AdjustmentParams = field(default_factory=AdjustmentParams)
    quality: QualityParams = field(default_factory=QualityParams)
    reissue: ReissueParams = field(default_factory=ReissueParams)
    dtm: DtmParams = field(default_factory=DtmParams)
    orthophoto: OrthophotoParams = field(default_factory=OrthophotoParams)
    contour: ContourParams = field(default_factory=ContourParams)
    slope: SlopeParams = field(default_factory=SlopeParams)
    hillshade: HillshadeParams = field(default_factory=HillshadeParams)
    insolation: InsolationParams = field(default_factory=InsolationParams)
    havens: HavenParams = field(default_factory=HavenParams)
    viewshed: ViewshedParams = field(default_factory=ViewshedParams)
    hazard: HazardParams = field(default_factory=HazardParams)
    footprints: FootprintParams = field(default_factory=FootprintParams)
    models: Models = field(default_factory=Models)
    panoramas: Panoramas = field(default_factory=Panoramas)
    wide: FarGround = field(default_factory=FarGround)
    region: Region = field(default_factory=Region)


def load_pipeline(name: str) -> PipelineConfig:
    """The pipeline of a shipped name or of a TOML file.

    Raises:
        ConfigError: there is no such pipeline, or a setting in it is wrong.
    """
    path, table = _read(name)
    return record_of(PipelineConfig, table, path.name)


def faults_of_pipeline(name: str) -> list[str]:
    """All errors of a pipeline's settings, one per line.

    Raises:
        ConfigError: there is no such pipeline, or its file is not TOML.
    """
    path, table = _read(name)
    return faults_of(PipelineConfig, table, path.name)


def _read(name: str) -> tuple[Path, dict[str, Any]]:
    path = PIPELINES / f"{name}.toml"
    if not path.is_file():
        path = Path(name)
    if not path.exists():
        shipped = ", ".join(sorted(file.stem for file in PIPELINES.glob("*.toml")))
        raise ConfigError(f"there is no pipeline {name!r}: name one of {shipped}, or a TOML file")
    return path, read_toml(path)
