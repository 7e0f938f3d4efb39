/** An orthophoto as one picture, put together from its tiles. */

import type { Bounds, RasterLayer, TileMatrixSet } from "../../server/records";

/** Pixels of the longer side: finer than a screen shows needs no one here. */
const MOST_PX = 1600;

export interface TilePlace {
  readonly url: string;
  /** Where its upper left corner lies in the picture, pixels. */
  readonly x: number;
  readonly y: number;
}

export interface MosaicPlan {
  readonly cellM: number;
  readonly width: number;
  readonly height: number;
  readonly tiles: readonly TilePlace[];
}

/** The tiles of the finest zoom at which a layer fits into the picture. */
export function mosaicPlan(layer: RasterLayer, set: TileMatrixSet): MosaicPlan {
  const [west, south, east, north] = layer.bounds;
  const finest = layer.maxzoom ?? set.cell_sizes.length - 1;
  const longest = Math.max(east - west, north - south);
  const fits = (zoom: number) => longest / (set.cell_sizes[zoom] ?? 1) <= MOST_PX;
  let zoom = finest;
  while (zoom > (layer.minzoom ?? 0) && !fits(zoom)) zoom -= 1;
  const cellM = set.cell_sizes[zoom] ?? 1;
  const side = cellM * set.tile_size;
  const [left, , , top] = set.extent;
  const first = [Math.floor((west - left) / side), Math.floor((top - north) / side)] as const;
  const last = [Math.ceil((east - left) / side), Math.ceil((top - south) / side)] as const;
  const tiles: TilePlace[] = [];
  for (let row = first[1]; row < last[1]; row += 1)
    for (let column = first[0]; column < last[0]; column += 1)
      tiles.push({
        url: tileUrl(layer, zoom, column, row),
        x: (left + column * side - west) / cellM,
        y: (north - (top - row * side)) / cellM,
      });
  return { cellM, width: (east - west) / cellM, height: (north - south) / cellM, tiles };
}

const tileUrl = ({ tiles }: RasterLayer, z: number, x: number, y: number) =>
  tiles.replace("{z}", String(z)).replace("{x}", String(x)).replace("{y}", String(y));

export interface Mosaic {
  readonly picture: OffscreenCanvas;
  readonly bounds: Bounds;
  readonly cellM: number;
}

export async function loadMosaic(layer: RasterLayer, set: TileMatrixSet): Promise<Mosaic> {
  const plan = mosaicPlan(layer, set);
  const picture = new OffscreenCanvas(Math.ceil(plan.width), Math.ceil(plan.height));
  const paper = picture.getContext("2d");
  await Promise.all(
    plan.tiles.map(async ({ url, x, y }) => {
      const tile = await fetch(url);
      if (tile.status === 204) return; // nothing was measured there
      paper?.drawImage(await createImageBitmap(await tile.blob()), x, y);
    }),
  );
  return { picture, bounds: layer.bounds, cellM: plan.cellM };
}
