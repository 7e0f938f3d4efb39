/**
 * Tiles that the server drew. They are decoded apart from the page: each `<img>` that is decoded the usual way makes
 * the browser put out a frame, which copies the whole map, and a first view has fifty of them.
 */

import ImageTile from "ol/source/ImageTile";
import type TileGrid from "ol/tilegrid/TileGrid";
import type { LocalMap } from "./projection";
import { tileUrl } from "./value-tiles";

/** Tiles of an address with {z}, {x} and {y}. */
export function pictureTiles(template: string, grid: TileGrid, { projection }: LocalMap) {
  return new ImageTile({
    loader: (z, x, y, { signal }) => picture(tileUrl(template, z, x, y), signal),
    projection,
    tileGrid: grid,
    interpolate: true,
    transition: 0, // to fade in takes seven frames a tile
    wrapX: false,
  });
}

async function picture(url: string, signal: AbortSignal): Promise<ImageBitmap> {
  const answer = await fetch(url, { signal });
  if (!answer.ok) throw new Error(`${url} was answered with ${answer.status}`);
  return createImageBitmap(await answer.blob());
}
