/** A raster layer, or a part of it, as one image composed of its tiles. */

import type { Bounds, RasterLayer, TileMatrixSet } from "../server/records";
import { loadTile } from "./image-tiles";
import { tileUrl } from "./value-tiles";

/** Most pixels of the longer side: more than a screen shows is not needed. */
const MOST_PX = 1600;

/** A tile as it is drawn; null where nothing was measured. */
export type TileImage = (z: number, x: number, y: number) => Promise<CanvasImageSource | null>;

interface TilePlace {
  readonly column: number;
  readonly row: number;
  /** Position of its upper left corner in the image, pixels. */
  readonly x: number;
  readonly y: number;
}

export interface MosaicPlan {
  readonly zoom: number;
  readonly cellM: number;
  /** Bounds of the whole cells that contain the requested extent. */
  readonly bounds: Bounds;
  readonly width: number;
  readonly height: number;
  readonly tiles: readonly TilePlace[];
}

/** The tiles of the finest zoom at which an extent fits into an image of at most this number of pixels. */
export function mosaicPlan(
  layer: Pick<RasterLayer, "bounds" | "minzoom" | "maxzoom">,
  set: TileMatrixSet,
  extent: Bounds = layer.bounds,
  mostPx = MOST_PX,
): MosaicPlan {
  const finest = layer.maxzoom ?? set.cell_sizes.length - 1;
  const longest = Math.max(extent[2] - extent[0], extent[3] - extent[1]);
  const fits = (zoom: number) => longest / (set.cell_sizes[zoom] ?? 1) <= mostPx;
  let zoom = finest;
  while (zoom > (layer.minzoom ?? 0) && !fits(zoom)) zoom -= 1;
  const cellM = set.cell_sizes[zoom] ?? 1;
  const [left, , , top] = set.extent;
  const cells = (metres: number, round: (value: number) => number) =>
    round(Number((metres / cellM).toFixed(3)));
  const [west, north] = [cells(extent[0] - left, Math.floor), cells(top - extent[3], Math.floor)];
  const [east, south] = [cells(extent[2] - left, Math.ceil), cells(top - extent[1], Math.ceil)];
  const side = set.tile_size;
  const tiles: TilePlace[] = [];
  for (let row = Math.floor(north / side); row * side < south; row += 1)
    for (let column = Math.floor(west / side); column * side < east; column += 1)
      tiles.push({ column, row, x: column * side - west, y: row * side - north });
  const bounds = [
    left + west * cellM,
    top - south * cellM,
    left + east * cellM,
    top - north * cellM,
  ];
  const [w = 0, s = 0, e = 0, n = 0] = bounds;
  return {
    zoom,
    cellM,
    bounds: [w, s, e, n],
    width: east - west,
    height: south - north,
    tiles,
  };
}

export interface Mosaic {
  readonly canvas: OffscreenCanvas;
  readonly bounds: Bounds;
  readonly cellM: number;
}

/** Tiles as the server draws them. */
const drawn =
  ({ tiles }: RasterLayer): TileImage =>
  (z, x, y) =>
    loadTile(tileUrl(tiles, z, x, y));

export async function loadMosaic(
  layer: RasterLayer,
  set: TileMatrixSet,
  plan: MosaicPlan = mosaicPlan(layer, set),
  tile: TileImage = drawn(layer),
): Promise<Mosaic> {
  const canvas = new OffscreenCanvas(plan.width, plan.height);
  const paper = canvas.getContext("2d");
  await Promise.all(
    plan.tiles.map(async ({ column, row, x, y }) => {
      const image = await tile(plan.zoom, column, row);
      if (image) paper?.drawImage(image, x, y);
    }),
  );
  return { canvas, bounds: plan.bounds, cellM: plan.cellM };
}
