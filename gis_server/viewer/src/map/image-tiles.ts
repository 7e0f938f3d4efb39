/**
 * Tiles that the server drew. They are decoded outside the page: each `<img>` decoded in the usual way makes
 * the browser produce a frame, which copies the whole map, and a first view has fifty of them.
 */

import ImageTile from "ol/source/ImageTile";
import type TileGrid from "ol/tilegrid/TileGrid";
import type { LocalMap } from "./projection";
import { count, type Recolour } from "./imagery-style";
import { SIDE, tileUrl } from "./value-tiles";

/** Tiles of an address with {z}, {x} and {y}; in other colours, if a style is given. */
export function imageTiles(
  template: string,
  grid: TileGrid,
  { projection }: LocalMap,
  recolour: Recolour | null = null,
) {
  return new ImageTile({
    loader: async (z, x, y, { signal }) => {
      const drawn = await loadTile(tileUrl(template, z, x, y), signal);
      if (!drawn) return emptyTile();
      return recolour ? recoloured(drawn, recolour) : drawn;
    },
    projection,
    tileGrid: grid,
    interpolate: true,
    transition: 0, // fading in takes seven frames per tile
    wrapX: false,
  });
}

/** The tile that the server drew; null where nothing was measured. */
export async function loadTile(url: string, signal?: AbortSignal): Promise<ImageBitmap | null> {
  const answer = await fetch(url, signal ? { signal } : {});
  if (answer.status === 204) return null;
  if (!answer.ok) throw new Error(`${url} was answered with ${answer.status}`);
  return createImageBitmap(await answer.blob());
}

export function emptyTile(): HTMLCanvasElement {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = SIDE;
  return canvas;
}

function canvasOf(drawn: ImageBitmap): CanvasRenderingContext2D {
  const context = emptyTile().getContext("2d", { willReadFrequently: true });
  if (!context) throw new Error("the browser provides no canvas for recolouring a tile");
  context.drawImage(drawn, 0, 0);
  return context;
}

export function recoloured(drawn: ImageBitmap, recolour: Recolour): HTMLCanvasElement {
  const context = canvasOf(drawn);
  const pixels = context.getImageData(0, 0, SIDE, SIDE);
  recolour(pixels.data);
  context.putImageData(pixels, 0, 0);
  return context.canvas;
}

/** Number of pixels of some tiles by shade. */
export async function shadesOf(addresses: readonly string[]): Promise<number[]> {
  const counts = Array.from({ length: 256 }, () => 0);
  for (const url of addresses) {
    const drawn = await loadTile(url);
    if (drawn) count(canvasOf(drawn).getImageData(0, 0, SIDE, SIDE).data, counts);
  }
  return counts;
}
