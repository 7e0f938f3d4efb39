/**
 * Layers that are fetched and drawn in a view: a mission of 500 stops has a layer of contours for each of them, ten
 * thousand footprints and a hundred thousand tie points, and a view of the whole shows none of their shapes.
 */

import type { Bounds, Layer } from "../server/records";

/** A layer of one stop is drawn from this size on, pixels. */
const LEAST_PX = 24;
/**
 * Metres a pixel at which these kinds have shapes: sixty pixels a footprint, and ties apart from each other. At
 * coarser resolutions footprints of a traverse overlap completely.
 */
const COARSEST: Readonly<Record<string, number>> = {
  footprints: 0.5,
  pointing: 0.5,
  "tie-points": 0.5,
};

/** The coarsest resolution at which a layer is drawn, metres a pixel. */
export function coarsest(layer: Pick<Layer, "kind" | "level" | "bounds" | "type">): number {
  const of = COARSEST[layer.kind];
  if (of !== undefined) return of;
  if (layer.type === "raster" || layer.level !== "stop") return Number.POSITIVE_INFINITY;
  const [west, south, east, north] = layer.bounds;
  const side = Math.max(east - west, north - south);
  return side > 0 ? side / LEAST_PX : Number.POSITIVE_INFINITY;
}

/** Whether a view of these bounds shows anything of a layer. */
export function isNeeded(
  layer: Pick<Layer, "kind" | "level" | "bounds" | "type">,
  [west, south, east, north]: Bounds,
  resolution: number,
): boolean {
  const [w, s, e, n] = layer.bounds;
  const meets = w <= east && e >= west && s <= north && n >= south;
  return meets && resolution <= coarsest(layer);
}
