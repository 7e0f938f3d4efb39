/** The range that spreads a layer's colours over what is on the screen. */

import type OlMap from "ol/Map";
import type { RasterLayer, TileMatrixSet } from "../server/records";
import { tileGrid } from "./map-layers";
import { valueTile } from "./painted-tiles";
import type { Quantity } from "./raster-style";
import { quantityOf, type SunPlace } from "./shading";
import { SIDE } from "./value-tiles";

/** Shares of the cells that the first and the last colour leave out. */
const CUT = 0.02;
/** Cells between those that are looked at, in rows and columns. */
const STEP = 4;

/** Values at the shares `cut` and 1 - `cut` of all that are known; null where none is. */
export function spread(values: number[], cut = CUT): readonly [number, number] | null {
  const known = values.filter(Number.isFinite).sort((a, b) => a - b);
  const low = known[Math.floor(cut * (known.length - 1))];
  const high = known[Math.ceil((1 - cut) * (known.length - 1))];
  return low === undefined || high === undefined || !(high > low) ? null : [low, high];
}

/** Addresses of the tiles that a view shows of a layer. */
export function tilesInView(
  map: OlMap,
  set: TileMatrixSet,
  layer: Pick<RasterLayer, "minzoom" | "maxzoom" | "bounds">,
): [z: number, x: number, y: number][] {
  const grid = tileGrid(set, layer);
  const view = map.getView();
  const extent = view.calculateExtent(map.getSize());
  const [west, south, east, north] = layer.bounds;
  const seen = [
    Math.max(west, extent[0] ?? west),
    Math.max(south, extent[1] ?? south),
    Math.min(east, extent[2] ?? east),
    Math.min(north, extent[3] ?? north),
  ];
  if ((seen[0] ?? 0) >= (seen[2] ?? 0) || (seen[1] ?? 0) >= (seen[3] ?? 0)) return [];
  const z = grid.getZForResolution(view.getResolution() ?? 1);
  const found: [number, number, number][] = [];
  grid.forEachTileCoord(seen, z, ([tz = 0, x = 0, y = 0]) => found.push([tz, x, y]));
  return found;
}

/** Range of a quantity over what is on the screen; null where nothing of it is known. */
export async function rangeInView(
  map: OlMap,
  set: TileMatrixSet,
  layer: RasterLayer,
  quantity: Quantity,
  sun: SunPlace,
): Promise<readonly [number, number] | null> {
  const addresses = tilesInView(map, set, layer);
  const tiles = await Promise.all(addresses.map((address) => valueTile(layer, set, address)));
  const values: number[] = [];
  for (const tile of tiles) if (tile) sample(quantityOf(tile, quantity, sun), values);
  return spread(values);
}

export function sample(tile: Float32Array, into: number[]): void {
  for (let row = 0; row < SIDE; row += STEP)
    for (let column = 0; column < SIDE; column += STEP)
      into.push(tile[row * SIDE + column] as number);
}
