/** The range that spreads a layer's colours over the values on the screen. */

import { getIntersection, isEmpty } from "ol/extent";
import type OlMap from "ol/Map";
import type { RasterLayer, TileMatrixSet } from "../server/records";
import { tileGrid } from "./map-layers";
import { styled, type ValuesOf } from "./painted-tiles";
import type { RasterStyle } from "./raster-style";
import type { SunPlace } from "./shading";
import { SIDE } from "./value-tiles";

/** Shares of the cells that the first and the last colour leave out. */
const CUT = 0.02;
/** Spacing of the sampled cells, in rows and columns. */
const STEP = 4;

/** Values at the shares `cut` and 1 - `cut` of the known ones; null without any. */
export function spread(values: number[], cut = CUT): readonly [number, number] | null {
  const known = values.filter(Number.isFinite).sort((a, b) => a - b);
  const low = known[Math.floor(cut * (known.length - 1))];
  const high = known[Math.ceil((1 - cut) * (known.length - 1))];
  return low === undefined || high === undefined || !(high > low) ? null : [low, high];
}

type Place = readonly [z: number, x: number, y: number];
type Ground = Pick<RasterLayer, "minzoom" | "maxzoom" | "bounds">;

/** A sample of the values that a view shows, NaN among them where nothing was measured. */
export async function sampleView(
  map: OlMap,
  set: TileMatrixSet,
  layer: Ground,
  values: ValuesOf,
): Promise<number[]> {
  const view = map.getView();
  const seen = getIntersection(view.calculateExtent(map.getSize()), [...layer.bounds]);
  if (isEmpty(seen)) return [];
  const grid = tileGrid(set, layer);
  const places: Place[] = [];
  const z = grid.getZForResolution(view.getResolution() ?? 1);
  grid.forEachTileCoord(seen, z, ([tz = 0, x = 0, y = 0]) => places.push([tz, x, y]));
  const found: number[] = [];
  const take = async (place: Place) => {
    const tile = await values(...place);
    if (tile) sample(tile, windowOf(seen, grid.getTileCoordExtent([...place])), found);
  };
  await Promise.all(places.map(take));
  return found;
}

/** Rows and columns of a tile inside the view. */
interface Window {
  readonly rows: readonly [number, number];
  readonly columns: readonly [number, number];
}

function windowOf(seen: readonly number[], tile: readonly number[]): Window {
  const [west = 0, south = 0, east = 0, north = 0] = seen;
  const [left = 0, bottom = 0, right = 0, top = 0] = tile;
  const [column, row] = [(right - left) / SIDE, (top - bottom) / SIDE];
  const within = (at: number) => Math.min(SIDE, Math.max(0, Math.round(at)));
  return {
    rows: [within((top - north) / row), within((top - south) / row)],
    columns: [within((west - left) / column), within((east - left) / column)],
  };
}

function sample(tile: Float32Array, { rows, columns }: Window, into: number[]): void {
  for (let row = rows[0]; row < rows[1]; row += STEP)
    for (let column = columns[0]; column < columns[1]; column += STEP)
      into.push(tile[row * SIDE + column] as number);
}

/** Range of a quantity on the screen; null if nothing of it is known. */
export async function rangeInView(
  map: OlMap,
  set: TileMatrixSet,
  layer: RasterLayer,
  style: RasterStyle,
  sun: SunPlace,
): Promise<readonly [number, number] | null> {
  return spread(await sampleView(map, set, layer, styled(layer, style, sun, set).values));
}
