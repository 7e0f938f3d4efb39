/** Layers of the server as layers of the map. */

import type Feature from "ol/Feature";
import GeoJSON from "ol/format/GeoJSON";
import type Geometry from "ol/geom/Geometry";
import type BaseLayer from "ol/layer/Base";
import TileLayer from "ol/layer/Tile";
import OlVectorLayer from "ol/layer/Vector";
import VectorImageLayer from "ol/layer/VectorImage";
import { tile as tileStrategy } from "ol/loadingstrategy";
import VectorSource from "ol/source/Vector";
import type ImageTile from "ol/source/ImageTile";
import TileGrid from "ol/tilegrid/TileGrid";
import { api, type FeatureCollection } from "../server/api";
import { blended } from "./blending";
import { coarsest } from "./extent-of-need";
import { zIndex } from "./layers";
import { PaintedTiles, styled } from "./painted-tiles";
import { imageTiles } from "./image-tiles";
import type { LocalMap } from "./projection";
import { recolouring } from "./imagery-style";
import { formatStyle, hasValues, type RasterStyle } from "./raster-style";
import type { SunPlace } from "./shading";
import type { Layer, RasterLayer, TileMatrixSet, VectorLayer } from "../server/records";
import { type DrawingState, drawingOf } from "./styles";

/** No tiles of a raster are requested when its coarsest one would shrink below 1/8. */
const COARSEST_SHRINK = 8;

export type FeatureSource = VectorSource<Feature<Geometry>>;

/** A layer of the map and what it shows. */
export interface Shown {
  readonly layer: Layer;
  readonly map: BaseLayer;
  /** Fetches features that are loaded whole, once; others load by squares in view. */
  readonly load: () => Promise<FeatureSource | null>;
  /** Draws the values here in a style of their own; null: as the server draws them. */
  readonly restyle: (style: RasterStyle | null, sun: SunPlace) => void;
}

/** Features whose coordinates are already map metres, whatever reference system the file names. */
export function readFeatures(collection: FeatureCollection): Feature<Geometry>[] {
  const { type, features } = collection;
  return new GeoJSON().readFeatures({ type, features }) as Feature<Geometry>[];
}

export function tileGrid(set: TileMatrixSet, layer: Pick<RasterLayer, "minzoom" | "maxzoom">) {
  const [west, south, east, north] = set.extent;
  const deepest = layer.maxzoom ?? set.cell_sizes.length - 1;
  return new TileGrid({
    extent: [west, south, east, north],
    origin: [west, north],
    resolutions: set.cell_sizes.slice(0, deepest + 1),
    minZoom: Math.min(layer.minzoom ?? 0, deepest),
    tileSize: set.tile_size,
  });
}

function raster(layer: RasterLayer, set: TileMatrixSet, map: LocalMap): Shown {
  const grid = tileGrid(set, layer);
  const drawn = imageTiles(layer.tiles, grid, map);
  const tiles = new TileLayer<ImageTile>({
    extent: [...layer.bounds],
    maxResolution: grid.getResolution(grid.getMinZoom()) * COARSEST_SHRINK,
    source: drawn,
  });
  let painted: PaintedTiles | null = null;
  let recoloured: { key: string; source: ImageTile } | null = null;
  /** The server's tiles in the colours of a style. */
  const drawnIn = (style: RasterStyle | null): ImageTile => {
    const recolour = recolouring(layer, style);
    if (!style || !recolour) return drawn;
    const key = formatStyle(style);
    if (recoloured?.key !== key)
      recoloured = { key, source: imageTiles(layer.tiles, grid, map, recolour) };
    return recoloured.source;
  };
  const restyle = (style: RasterStyle | null, sun: SunPlace) => {
    if (!style || !hasValues(layer)) {
      const source = drawnIn(style);
      if (tiles.getSource() !== source) tiles.setSource(source);
      return;
    }
    const painting = styled(layer, style, sun, set);
    if (painted) painted.repaint(painting);
    else painted = new PaintedTiles(painting, grid, map);
    if (tiles.getSource() !== painted) tiles.setSource(painted);
  };
  return { layer, map: tiles, load: async () => null, restyle };
}

/** Kinds with many features, which are drawn as one raster image while the map moves. */
const MANY = new Set(["footprints", "pointing", "tie-points"]);
/** Kinds with few features that people follow while the map moves: redrawn in every frame. */
const FEW = new Set(["stops", "traverse"]);
const LABELLED = new Set(["contours", "region-contours", "far-contours", "stops"]);
/** Kinds that are fetched piece by piece, in squares of the map, and the side of these. */
const PIECES: Readonly<Record<string, number>> = {
  "tie-points": 128,
  footprints: 128,
  pointing: 128,
};

const isNewTo = (source: FeatureSource) => (feature: Feature<Geometry>) => {
  const id = feature.getId();
  return id === undefined || source.getFeatureById(id) === null;
};

/** A source that fetches the squares in view. */
function inPieces(layer: VectorLayer, side: number, set: TileMatrixSet): FeatureSource {
  const [west, south, east, north] = set.extent;
  const squares = new TileGrid({
    extent: [west, south, east, north],
    origin: [west, north],
    resolutions: [side / set.tile_size],
    tileSize: set.tile_size,
  });
  const source: FeatureSource = new VectorSource<Feature<Geometry>>({
    strategy: tileStrategy(squares),
    loader: (extent, _resolution, _projection, success, failure) => {
      const [w = 0, s = 0, e = 0, n = 0] = extent;
      api
        .features(layer, [w, s, e, n])
        .then((found) => {
          // Features across the edge of a square arrive with both.
          const features = readFeatures(found).filter(isNewTo(source));
          source.addFeatures(features);
          success?.(features);
        })
        .catch(() => {
          source.removeLoadedExtent(extent); // fetched again when it is next shown
          failure?.();
        });
    },
  });
  return source;
}

function vectorMap(layer: VectorLayer, source: FeatureSource, state: DrawingState): BaseLayer {
  const maxResolution = coarsest(layer) * (1 + 1e-9); // OpenLayers leaves the limit itself out
  const drawn = { source, style: drawingOf(layer.kind, state), maxResolution };
  if (MANY.has(layer.kind)) return new VectorImageLayer({ ...drawn, imageRatio: 1.5 });
  return new OlVectorLayer({
    ...drawn,
    declutter: LABELLED.has(layer.kind),
    updateWhileInteracting: FEW.has(layer.kind),
    renderBuffer: 200,
  });
}

function vector(layer: VectorLayer, set: TileMatrixSet, state: DrawingState): Shown {
  const side = PIECES[layer.kind];
  const source = side ? inPieces(layer, side, set) : new VectorSource<Feature<Geometry>>();
  let loading: Promise<FeatureSource> | null = null;
  const load = async () => {
    if (!side) source.addFeatures(readFeatures(await api.features(layer)));
    return source;
  };
  return {
    layer,
    map: vectorMap(layer, source, state),
    load: () => {
      loading ??= load().catch((reason: unknown) => {
        loading = null;
        throw reason;
      });
      return loading;
    },
    restyle: () => undefined,
  };
}

export function show(layer: Layer, set: TileMatrixSet, map: LocalMap, state: DrawingState): Shown {
  const shown = build(layer, set, map, state);
  blended(shown.map).setZIndex(zIndex(layer));
  return shown;
}

function build(layer: Layer, set: TileMatrixSet, map: LocalMap, state: DrawingState): Shown {
  switch (layer.type) {
    case "raster":
      return raster(layer, set, map);
    case "vector":
      return vector(layer, set, state);
    default:
      throw new Error(`unknown layer ${JSON.stringify(layer satisfies never)}`);
  }
}
