/** Quality bands of a terrain model, each listed as a layer of its own. */

import type { Layer, RasterLayer } from "../server/records";
import { kindTitle } from "./kinds";
import { hasValues, QUALITIES } from "./raster-style";

const MODELS = new Set(["dtm", "region-dtm"]);
/** Kind of the layer that shows from which stop the ground of a region is. */
export const SOURCE_STOP = "region-dtm-source";

/** Whether a layer is a band of another one: it has no versions of its own. */
export const isBand = ({ kind }: Pick<Layer, "kind">) => /^(region-)?dtm-/.test(kind);

export function bandsOf(layer: Layer): readonly RasterLayer[] {
  if (!hasValues(layer) || !MODELS.has(layer.kind)) return [];
  const band = (name: string): RasterLayer => {
    const kind = `${layer.kind}-${name}`;
    const [id, title] = [`${layer.id}-${name}`, `${layer.title}: ${kindTitle(kind)}`];
    return { ...layer, id, kind, title, legend: null, range: null };
  };
  const known = QUALITIES.map(band);
  if (layer.kind !== "region-dtm") return known;
  const tiles = `${layer.tiles}?style=source`;
  return [...known, { ...band("source"), tiles, values: null, unit: null }];
}

/** Query for the legend of a layer whose file names the classes; null: the layer's entry has its legend. */
export function legendQuery({ kind }: Pick<Layer, "kind">): string | null {
  if (kind === "sources") return "";
  return kind === SOURCE_STOP ? "?style=source" : null;
}
