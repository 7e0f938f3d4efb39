/**
 * Raster layers of the map over the ground: those of the merged map over the ground of all stops, a stop's own over its
 * own.
 */

import { CanvasTexture, SRGBColorSpace, type Texture } from "three";
import { kindTitle, LISTED } from "../../../map/kinds";
import { loadMosaic, mosaicPlan } from "../../../map/mosaic";
import { tilesOf } from "../../../map/painted-tiles";
import type { Bounds, RasterLayer } from "../../../server/records";
import type { Context } from "../../../session/context";

/** Pixels of the longer side of the texture of one tile of the ground: as many as its photograph has. */
const MOST_PX = 1024;
const MERGED = "region-";

/** Kinds that no single stop has. */
const ONLY_MERGED = new Set(["seams", "dtm-source"]);

const plain = (kind: string) => (kind.startsWith(MERGED) ? kind.slice(MERGED.length) : kind);
const rasters = ({ layers }: Context) =>
  layers.listed.filter((layer): layer is RasterLayer => layer.type === "raster");

/** Kinds of layers that may be draped, and their titles, as the list of layers has them. */
export function drapable(context: Context): readonly (readonly [kind: string, title: string])[] {
  const kinds = new Set(rasters(context).map(({ kind }) => plain(kind)));
  const place = (kind: string) => LISTED.indexOf(kind) + 1 || LISTED.indexOf(MERGED + kind) + 1;
  return [...kinds]
    .sort((a, b) => place(a) - place(b))
    .map((kind) => [kind, kindTitle(ONLY_MERGED.has(kind) ? MERGED + kind : kind)]);
}

export const overlap = (a: Bounds, b: Bounds): Bounds | null => {
  const [west, south] = [Math.max(a[0], b[0]), Math.max(a[1], b[1])];
  const [east, north] = [Math.min(a[2], b[2]), Math.min(a[3], b[3])];
  return west < east && south < north ? [west, south, east, north] : null;
};

/** The layer of a kind for the ground of a stop; `isAlone`: no other stop's ground is shown. */
export function layerFor(
  context: Context,
  kind: string,
  scope: string,
  isAlone: boolean,
  bounds: Bounds | null = null,
): RasterLayer | null {
  const all = rasters(context);
  const own = all.find((layer) => layer.kind === kind && layer.scope === scope);
  const merged = all.find(
    (layer) => layer.kind === MERGED + kind && (!bounds || overlap(layer.bounds, bounds)),
  );
  return (isAlone ? (own ?? merged) : (merged ?? own)) ?? null;
}

/** Kind of layer that is the photograph of the ground of all stops: equally bright everywhere; null: there is none. */
export const mergedPhotograph = (context: Context): string | null =>
  rasters(context).some(({ kind }) => kind === `${MERGED}orthophoto`) ? "orthophoto" : null;

export interface Draped {
  readonly texture: Texture;
  readonly bounds: Bounds;
}

/** A layer within bounds as the map shows it; null where it has nothing there. */
export async function drapeOf(
  { layers, sun, mission }: Context,
  layer: RasterLayer,
  within: Bounds,
): Promise<Draped | null> {
  const common = overlap(layer.bounds, within);
  if (!common) return null;
  const set = mission.tile_matrix_set;
  const tile = tilesOf(layer, layers.state(layer).style, sun.value, set);
  const { canvas, bounds } = await loadMosaic(
    layer,
    set,
    mosaicPlan(layer, set, common, MOST_PX),
    tile,
  );
  const texture = new CanvasTexture(canvas);
  texture.colorSpace = SRGBColorSpace;
  texture.premultiplyAlpha = true;
  return { texture, bounds };
}
